// Answers the questions of `palpate bench public` with a SOFA scene. A stiff spring of the scene holds the touched
// node of the body to a tool of one point; this controller moves the tool and reads the force of the spring.
//
//     <PalpateQuestions questions="questions/point" answers="answers/point" body="@body/state" tool="@tool/state"
//                       stiffness="1e6" settle="50"/>
//
// sofa_questions.scn is such a scene; sofa_scene fills in its nodes. A position is answered after `settle` steps, a
// sample of a way after one: the time step of the scene is that of the questions, 1 ms. Units of the scene: m, kg, s.
// With the flags of SOFA's own build in $SOFA:
//
//     c++ -std=c++17 -shared -fPIC -I hil/bridges hil/bridges/SofaQuestions.cpp $SOFA -o libPalpateQuestions.so
#include <cmath>
#include <memory>
#include <string>

#include <sofa/component/controller/Controller.h>
#include <sofa/core/ObjectFactory.h>
#include <sofa/core/behavior/BaseMechanicalState.h>

#include "bench_questions.h"

namespace palpate {

class PalpateQuestions : public sofa::component::controller::Controller {
public:
    SOFA_CLASS(PalpateQuestions, sofa::component::controller::Controller);

    Data<std::string> d_questions, d_answers;
    Data<double> d_stiffness;
    Data<int> d_settle;
    Data<double> d_change;
    Data<int> d_longest;
    sofa::core::objectmodel::SingleLink<PalpateQuestions, sofa::core::behavior::BaseMechanicalState,
                                        sofa::core::objectmodel::BaseLink::FLAG_STOREPATH | sofa::core::objectmodel::BaseLink::FLAG_STRONGLINK>
        l_body, l_tool;

    // Whether every question is answered.
    bool finished() const { return m_sheet >= m_sheets.size() && m_ready; }

    void init() override
    {
        Controller::init();
        d_componentState.setValue(sofa::core::objectmodel::ComponentState::Invalid);
        try {
            if (l_body.get() == nullptr || l_tool.get() == nullptr) throw std::runtime_error("give the states `body` and `tool`");
            questions::Table place(d_questions.getValue() + "/place.csv");
            m_node = static_cast<unsigned int>(place.number(0, "node"));
            m_rest = place.vector(0, "x_m", "y_m", "z_m");
            for (const char *name : {"positions.csv", "loops.csv", "hands.csv"}) m_sheets.emplace_back(d_questions.getValue(), name);
        } catch (const std::exception &error) {
            msg_error() << error.what();
            return;
        }
        m_ready = true;
        skipEmpty();
        d_componentState.setValue(sofa::core::objectmodel::ComponentState::Valid);
    }

    void onBeginAnimationStep(const double) override
    {
        if (!m_ready || finished() || m_steps > 0) return;
        const questions::Vec3 &d = m_sheets[m_sheet].asked()[m_number].displacement_m;
        auto *tool = l_tool.get();
        tool->applyTranslation(m_rest.x + d.x - tool->getPX(0), m_rest.y + d.y - tool->getPY(0), m_rest.z + d.z - tool->getPZ(0));
    }

    void onEndAnimationStep(const double) override
    {
        if (!m_ready || finished()) return;
        const questions::Question &asked = m_sheets[m_sheet].asked()[m_number];
        auto *body = l_body.get();
        auto *tool = l_tool.get();
        const double k = d_stiffness.getValue();
        const questions::Vec3 force{k * (tool->getPX(0) - body->getPX(m_node)), k * (tool->getPY(0) - body->getPY(m_node)),
                                    k * (tool->getPZ(0) - body->getPZ(m_node))};
        ++m_steps;
        // The tool comes to the beginning of a way as to a single position.
        if (asked.begins && !isAtRest(force)) return;
        m_steps = m_still = 0;
        m_sheets[m_sheet].answer(m_number, force);
        if (++m_number < m_sheets[m_sheet].asked().size()) return;
        write();
        ++m_sheet;
        m_number = 0;
        skipEmpty();
    }

protected:
    PalpateQuestions()
        : d_questions(initData(&d_questions, std::string(), "questions", "Folder of the questions about an organ")),
          d_answers(initData(&d_answers, std::string(), "answers", "Existing folder for the answers")),
          d_stiffness(initData(&d_stiffness, 1e6, "stiffness", "Stiffness of the spring between tool and body, N/m")),
          d_settle(initData(&d_settle, 50, "settle", "A body is at rest if its force changes by less than `change` in so many steps")),
          d_change(initData(&d_change, 1e-3, "change", "Largest change of the force of a body at rest, as a share of it")),
          d_longest(initData(&d_longest, 10000, "longest", "Steps after which a position is answered in motion")),
          l_body(initLink("body", "State of the body, with the nodes of nodes.csv")),
          l_tool(initLink("tool", "State of the tool, one point"))
    {
    }

private:
    // Waves and damping need time: the answer is the force once it has stayed for `settle` steps.
    bool isAtRest(const questions::Vec3 &force)
    {
        const double change = std::hypot(force.x - m_force.x, force.y - m_force.y, force.z - m_force.z);
        const bool stays = change <= d_change.getValue() * std::hypot(force.x, force.y, force.z) + 1e-6;
        m_still = stays ? m_still + 1 : 0;
        if (!stays) m_force = force;
        if (m_steps < d_longest.getValue()) return m_still >= d_settle.getValue();
        msg_warning() << d_answers.getValue() << ": a position is answered while the body still moves; damp it more";
        return true;
    }
    void write()
    {
        if (!m_sheets[m_sheet].write(d_answers.getValue())) msg_error() << d_answers.getValue() << ": cannot be written; make the folder first";
    }
    void skipEmpty()
    {
        while (m_sheet < m_sheets.size() && m_sheets[m_sheet].asked().empty()) {
            write();
            ++m_sheet;
        }
    }

    std::vector<questions::Sheet> m_sheets;
    size_t m_sheet = 0, m_number = 0;
    int m_steps = 0, m_still = 0;
    // The force from which `m_still` counts.
    questions::Vec3 m_force{};
    bool m_ready = false;
    unsigned int m_node = 0;
    questions::Vec3 m_rest;
};

} // namespace palpate

// What SOFA looks up in a plug-in.
extern "C" {
SOFA_EXPORT_DYNAMIC_LIBRARY void initExternalModule() {}
SOFA_EXPORT_DYNAMIC_LIBRARY const char *getModuleName() { return "PalpateQuestions"; }
SOFA_EXPORT_DYNAMIC_LIBRARY const char *getModuleVersion() { return "0.1"; }
SOFA_EXPORT_DYNAMIC_LIBRARY const char *getModuleLicense() { return "MIT OR Apache-2.0"; }
SOFA_EXPORT_DYNAMIC_LIBRARY const char *getModuleDescription() { return "Answers of a SOFA scene to the benchmark of Palpate"; }
SOFA_EXPORT_DYNAMIC_LIBRARY void registerObjects(sofa::core::ObjectFactory *factory)
{
    factory->registerObjects(
        sofa::core::ObjectRegistrationData("Asks a scene the questions of palpate bench public.").add<palpate::PalpateQuestions>());
}
}
