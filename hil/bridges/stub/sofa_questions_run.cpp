// Runs the controller of SofaQuestions.cpp on a body of springs instead of a SOFA scene: node N follows the tool with the
// stiffness of the scene, against 200, 300 and 400 N/m along x, y and z. Then h = k_b k_s / (k_b + k_s) d. It moves by at most
// 0.3 mm a step, so that a single position is not at rest at once.
//
//     sofa_questions_run QUESTIONS ANSWERS
#include "../SofaQuestions.cpp"

#include <algorithm>

namespace {

struct State : sofa::core::behavior::BaseMechanicalState {
    double at[3] = {0, 0, 0};
    SReal getPX(unsigned int) const override { return at[0]; }
    SReal getPY(unsigned int) const override { return at[1]; }
    SReal getPZ(unsigned int) const override { return at[2]; }
    void applyTranslation(const SReal dx, const SReal dy, const SReal dz) override
    {
        at[0] += dx;
        at[1] += dy;
        at[2] += dz;
    }
};

} // namespace

int main(int argc, char **argv)
{
    if (argc != 3) return 2;
    sofa::core::ObjectFactory factory;
    registerObjects(&factory);
    auto made = factory.creator(), second = factory.creator();
    auto &asker = dynamic_cast<palpate::PalpateQuestions &>(*made), &broken = dynamic_cast<palpate::PalpateQuestions &>(*second);
    broken.init();
    if (broken.d_componentState.getValue() != sofa::core::objectmodel::ComponentState::Invalid) return 3;
    State body, tool;
    asker.d_questions.setValue(argv[1]);
    asker.d_answers.setValue(argv[2]);
    asker.l_body.set(&body);
    asker.l_tool.set(&tool);
    asker.init();
    questions::Table place(std::string(argv[1]) + "/place.csv");
    const double rest[3] = {place.number(0, "x_m"), place.number(0, "y_m"), place.number(0, "z_m")};
    const double body_n_m[3] = {200, 300, 400}, spring_n_m = asker.d_stiffness.getValue();
    for (int axis = 0; axis < 3; ++axis) body.at[axis] = rest[axis];
    for (int step = 0; step < 1000000 && !asker.finished(); ++step) {
        asker.onBeginAnimationStep(1e-3);
        for (int axis = 0; axis < 3; ++axis) {
            const double to = (body_n_m[axis] * rest[axis] + spring_n_m * tool.at[axis]) / (body_n_m[axis] + spring_n_m);
            body.at[axis] += std::clamp(to - body.at[axis], -3e-4, 3e-4);
        }
        asker.onEndAnimationStep(1e-3);
    }
    return asker.finished() ? 0 : 4;
}
