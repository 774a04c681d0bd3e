// Palpate as the force feedback of a SOFA scene: the driver of the haptic device calls it at 1 kHz, and it
// answers with the force of a precomputed organ. The scene itself simulates nothing for it.
//
//     <PalpateForceFeedback blob="organ.blob" metresPerUnit="0.001" maxForce="3" activate="0"/>
//
// Changing `activate` from 0 to 1 while the scene runs arms, 0 disarms. After a fault the force is zero until
// `activate` has been 0 and 1 again. A scene that starts with 1 does not arm. With the flags of SOFA's own build in
// $SOFA this is a plug-in:
//
//     c++ -std=c++17 -shared -fPIC -I firmware-like-core/c-api/include hil/bridges/SofaForceFeedback.cpp $SOFA
//         -L target/firmware -lpalpate_c -o libPalpate.so
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include <sofa/component/haptics/ForceFeedback.h>
#include <sofa/core/objectmodel/DataFileName.h>
#if __has_include(<sofa/type/Transform.h>)
#include <sofa/type/Transform.h>
#else
#include <sofa/defaulttype/SolidTypes.h>
#endif

#include "palpate.h"

namespace palpate {

class PalpateForceFeedback : public sofa::component::haptics::ForceFeedback {
public:
    SOFA_CLASS(PalpateForceFeedback, sofa::component::haptics::ForceFeedback);

    // SOFA has moved these types.
#if __has_include(<sofa/type/Transform.h>)
    using Transform = sofa::type::Transform<SReal>;
    using SpatialVector = sofa::type::SpatialVector<SReal>;
#else
    using Transform = sofa::defaulttype::SolidTypes<SReal>::Transform;
    using SpatialVector = sofa::defaulttype::SolidTypes<SReal>::SpatialVector;
#endif

    sofa::core::objectmodel::DataFileName d_blob;
    Data<double> d_metresPerUnit, d_workspaceScale, d_maxForce, d_maxStiffness;

    void init() override;

    // Position of the tool in the world, scene units; force for the hand, N, in axes of the world. The
    // orientation (u, v, w, q) has no effect: the tool is a point.
    void computeForce(SReal x, SReal y, SReal z, SReal u, SReal v, SReal w, SReal q, SReal &fx, SReal &fy, SReal &fz) override;
    // The same as a wrench at the tool, without torque.
    void computeWrench(const Transform &world_H_tool, const SpatialVector &V_tool_world, SpatialVector &W_tool_world) override;
    // Frame of the model in the world; identity if it is never called. Not while the hand touches.
    void setReferencePosition(Transform &referencePosition) override;
    // While locked the force is zero.
    void setLock(bool value) override;

    // State of the controller, for a display.
    PalpatePhase phase() const { return m_phase; }

protected:
    PalpateForceFeedback();

private:
    struct alignas(PALPATE_ALIGNMENT) Word {
        unsigned char bytes[PALPATE_ALIGNMENT];
    };
    using Words = std::unique_ptr<Word[]>;
    static Words words(size_t bytes) { return Words(new Word[bytes / sizeof(Word) + 1]()); }
    static uint8_t *raw(const Words &words) { return reinterpret_cast<uint8_t *>(words.get()); }

    std::string open();
    void updateArming();

    // The driver's thread computes; the scene's thread sets reference and lock.
    std::mutex m_mutex;
    Words m_blob, m_organMemory, m_controllerMemory;
    std::vector<uint32_t> m_surface;
    const PalpateOrgan *m_organ = nullptr;
    PalpateController *m_controller = nullptr;
    Transform m_reference = Transform::identity();
    double m_scale = 1;
    std::atomic<PalpatePhase> m_phase{PALPATE_PHASE_DISARMED};
    bool m_active = true, m_permitted = false, m_locked = false;
};

} // namespace palpate
