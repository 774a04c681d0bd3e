// See SofaForceFeedback.h.
#include "SofaForceFeedback.h"

#include <algorithm>
#include <chrono>
#include <fstream>
#include <iterator>

#include <sofa/core/ObjectFactory.h>

namespace palpate {

PalpateForceFeedback::PalpateForceFeedback()
    : d_blob(initData(&d_blob, "blob", "The .blob file of the organ")),
      d_metresPerUnit(initData(&d_metresPerUnit, 1.0, "metresPerUnit", "Metres of the model per unit of the scene")),
      d_workspaceScale(initData(&d_workspaceScale, 1.0, "workspaceScale", "Metres of the model per metre of the device, with the scale of the driver")),
      d_maxForce(initData(&d_maxForce, 3.0, "maxForce", "Largest force of the device, N")),
      d_maxStiffness(initData(&d_maxStiffness, 1000.0, "maxStiffness", "Largest stiffness that the device renders stably, N/m at the hand"))
{
}

void PalpateForceFeedback::init()
{
    ForceFeedback::init();
    std::lock_guard<std::mutex> lock(m_mutex);
    std::string wrong = open();
    if (!wrong.empty()) {
        m_controller = nullptr;
        msg_error() << d_blob.getFullPath() << ": " << wrong;
        d_componentState.setValue(sofa::core::objectmodel::ComponentState::Invalid);
        return;
    }
    d_componentState.setValue(sofa::core::objectmodel::ComponentState::Valid);
}

// Opens the blob and the controller; returns what is wrong, or an empty text.
std::string PalpateForceFeedback::open()
{
    std::ifstream file(d_blob.getFullPath(), std::ios::binary);
    std::vector<char> bytes((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
    if (!file.is_open() || bytes.empty()) return "cannot be read";
    m_blob = words(bytes.size());
    std::copy(bytes.begin(), bytes.end(), reinterpret_cast<char *>(m_blob.get()));
    m_organMemory = words(palpate_organ_size());
    m_controllerMemory = words(palpate_controller_size());
    PalpateProblem problem;
    if (palpate_organ_open(raw(m_organMemory), palpate_organ_size(), raw(m_blob), bytes.size(), &m_organ, &problem) != PALPATE_STATUS_OK) {
        return palpate_status_text(problem.status);
    }
    PalpateOrganInfo info;
    palpate_organ_info(m_organ, &info);
    // Nothing bounds the error of a blob without a certificate.
    if (!info.certified) return "has no certificate: pack it again";

    m_scale = d_metresPerUnit.getValue();
    double workspace_scale = d_workspaceScale.getValue();
    PalpateConfig config;
    palpate_config(PALPATE_METHOD_ENERGY, &config);
    config.max_force_n = std::min({config.max_force_n, info.max_force_n, static_cast<float>(d_maxForce.getValue())});
    config.max_stiffness_n_m = static_cast<float>(d_maxStiffness.getValue() / workspace_scale);
    config.workspace_scale = static_cast<float>(workspace_scale);
    if (palpate_controller_open(raw(m_controllerMemory), palpate_controller_size(), m_organ, &config, &m_controller, &problem)
        != PALPATE_STATUS_OK) {
        return std::string(palpate_status_text(problem.status)) + " " + problem.what;
    }
    m_surface.resize(palpate_surface_words(m_organ));
    if (!m_surface.empty() && palpate_controller_on_surface(m_controller, m_surface.data(), m_surface.size()) != PALPATE_STATUS_OK) {
        return "its surface cannot be used";
    }
    return "";
}

// Arms on the change of `activate` from 0 to 1, and again after a lock.
void PalpateForceFeedback::updateArming()
{
    bool active = d_activate.getValue();
    if (active && !m_active) {
        palpate_reset(m_controller);
        m_permitted = true;
        m_phase = PALPATE_PHASE_DISARMED;
    }
    m_active = active;
    m_permitted = m_permitted && active;
    if (!m_permitted || m_locked) palpate_disarm(m_controller);
    else if (m_phase == PALPATE_PHASE_DISARMED) palpate_arm(m_controller);
}

void PalpateForceFeedback::computeForce(SReal x, SReal y, SReal z, SReal, SReal, SReal, SReal, SReal &fx, SReal &fy, SReal &fz)
{
    fx = fy = fz = 0;
    std::lock_guard<std::mutex> lock(m_mutex);
    if (m_controller == nullptr) return;
    updateArming();

    auto since = std::chrono::steady_clock::now().time_since_epoch();
    const auto model = m_reference.backProjectPoint(typename Transform::Vec(x, y, z));
    PalpateSample sample{};
    sample.t_us = static_cast<uint64_t>(std::chrono::duration_cast<std::chrono::microseconds>(since).count());
    for (int axis = 0; axis < 3; ++axis) sample.position_m[axis] = static_cast<float>(m_scale * model[axis]);
    PalpateCommand command;
    // A call that fails, and every fault, gives zero force.
    palpate_tick(m_controller, sample.t_us, &sample, &command);
    m_phase = command.phase;

    const float *n = command.hand_force_n;
    const auto world_n = m_reference.projectVector(typename Transform::Vec(n[0], n[1], n[2]));
    fx = world_n[0];
    fy = world_n[1];
    fz = world_n[2];
}

void PalpateForceFeedback::computeWrench(const Transform &world_H_tool, const SpatialVector &, SpatialVector &W_tool_world)
{
    const auto at = world_H_tool.getOrigin();
    SReal fx, fy, fz;
    computeForce(at[0], at[1], at[2], 0, 0, 0, 1, fx, fy, fz);
    W_tool_world.clear();
    W_tool_world.setForce(typename Transform::Vec(fx, fy, fz));
}

void PalpateForceFeedback::setReferencePosition(Transform &referencePosition)
{
    std::lock_guard<std::mutex> lock(m_mutex);
    m_reference = referencePosition;
}

void PalpateForceFeedback::setLock(bool value)
{
    std::lock_guard<std::mutex> lock(m_mutex);
    m_locked = value;
}

} // namespace palpate

// What SOFA looks up in a plug-in.
extern "C" {
SOFA_EXPORT_DYNAMIC_LIBRARY void initExternalModule() {}
SOFA_EXPORT_DYNAMIC_LIBRARY const char *getModuleName() { return "Palpate"; }
SOFA_EXPORT_DYNAMIC_LIBRARY const char *getModuleVersion() { return "0.1"; }
SOFA_EXPORT_DYNAMIC_LIBRARY const char *getModuleLicense() { return "MIT OR Apache-2.0"; }
SOFA_EXPORT_DYNAMIC_LIBRARY const char *getModuleDescription() { return "Force feedback of precomputed soft organs"; }
SOFA_EXPORT_DYNAMIC_LIBRARY void registerObjects(sofa::core::ObjectFactory *factory)
{
    factory->registerObjects(sofa::core::ObjectRegistrationData("Force of a precomputed organ of Palpate, for haptic devices.")
                                 .add<palpate::PalpateForceFeedback>());
}
}
