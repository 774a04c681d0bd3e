// Plays the haptic thread of a SOFA driver on the component, with the stand-ins for SOFA.
//
//     sofa_press BLOB REST NORMAL LOG      places as judge prints them
//
// The scene is in millimetres, and the model is turned by 90 degrees about z and moved in it. LOG has the stroke
// in axes of the model about the active node, millimetres, for judge. Exit code 1 with a line if the component
// breaks a rule.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <string>
#include <thread>

#include "../SofaForceFeedback.h"
#include <sofa/core/ObjectFactory.h>

extern "C" void registerObjects(sofa::core::ObjectFactory *factory);

using palpate::PalpateForceFeedback;

static const double MOVED_MM[3] = {40, -25, 10};
static double rest_mm[3], normal[3];

struct Force {
    double model_n[3], size_n;
};

// The force at a height above the active node; the thread sleeps until the next tick.
static Force feel(PalpateForceFeedback &component, double height_mm, std::FILE *log = nullptr)
{
    double at[3], world[3], n[3];
    for (int axis = 0; axis < 3; ++axis) at[axis] = height_mm * normal[axis];
    const double model[3] = {rest_mm[0] + at[0], rest_mm[1] + at[1], rest_mm[2] + at[2]};
    world[0] = -model[1] + MOVED_MM[0];
    world[1] = model[0] + MOVED_MM[1];
    world[2] = model[2] + MOVED_MM[2];
    component.computeForce(world[0], world[1], world[2], 0, 0, 0, 0, n[0], n[1], n[2]);
    Force force{{n[1], -n[0], n[2]}, std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])};
    auto t_us = std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now().time_since_epoch()).count();
    if (log != nullptr) {
        std::fprintf(log, "%lld %.5f %.5f %.5f %.5f %.5f %.5f\n", static_cast<long long>(t_us), at[0], at[1], at[2],
                     force.model_n[0], force.model_n[1], force.model_n[2]);
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
    return force;
}

// Moves at 40 mm/s, slower than any fault; returns the last force.
static Force move(PalpateForceFeedback &component, double from_mm, double to_mm, std::FILE *log = nullptr)
{
    int ticks = static_cast<int>(std::fabs(to_mm - from_mm) / 0.04);
    for (int tick = 0; tick < ticks; ++tick) feel(component, from_mm + (to_mm - from_mm) * tick / ticks, log);
    return feel(component, to_mm, log);
}

static int fail(const char *what, double number)
{
    std::fprintf(stderr, "sofa_press: %s: %g\n", what, number);
    return 1;
}

int main(int argc, char **argv)
{
    if (argc != 5 || std::sscanf(argv[2], "%lf,%lf,%lf", &rest_mm[0], &rest_mm[1], &rest_mm[2]) != 3
        || std::sscanf(argv[3], "%lf,%lf,%lf", &normal[0], &normal[1], &normal[2]) != 3) {
        return 2;
    }
    for (double &axis : rest_mm) axis *= 1000;
    sofa::core::ObjectFactory factory;
    registerObjects(&factory);
    auto made = factory.creator(), second = factory.creator();
    auto &component = dynamic_cast<PalpateForceFeedback &>(*made), &broken = dynamic_cast<PalpateForceFeedback &>(*second);

    broken.d_blob.setValue("/dev/null");
    broken.d_activate.setValue(true);
    broken.init();
    if (broken.d_componentState.getValue() != sofa::core::objectmodel::ComponentState::Invalid) return fail("an empty blob was accepted", 0);
    if (feel(broken, -5).size_n != 0) return fail("a component without an organ has a force", 0);

    component.d_blob.setValue(argv[1]);
    component.d_metresPerUnit.setValue(0.001);
    component.d_maxForce.setValue(5);
    component.d_activate.setValue(true);
    component.init();
    const double half = std::sqrt(0.5);
    PalpateForceFeedback::Transform reference({MOVED_MM[0], MOVED_MM[1], MOVED_MM[2]}, {0, 0, half, half});
    component.setReferencePosition(reference);

    Force force = move(component, 10, -5);
    if (force.size_n != 0) return fail("a scene that starts with activate = 1 has armed, N", force.size_n);
    move(component, -5, 10);
    component.d_activate.setValue(false);
    feel(component, 10);
    component.d_activate.setValue(true);
    // The force rises for half a second after arming.
    for (int tick = 0; tick < 700; ++tick) feel(component, 10);
    std::FILE *log = std::fopen(argv[4], "w");
    if (log == nullptr) return fail("the log cannot be written", 0);
    move(component, 10, -10, log);
    for (int tick = 0; tick < 700; ++tick) force = feel(component, -10, log);
    std::fclose(log);

    PalpateForceFeedback::Transform tool({-(rest_mm[1] - 10 * normal[1]) + MOVED_MM[0], rest_mm[0] - 10 * normal[0] + MOVED_MM[1],
                                          rest_mm[2] - 10 * normal[2] + MOVED_MM[2]},
                                         {});
    PalpateForceFeedback::SpatialVector wrench;
    component.computeWrench(tool, {}, wrench);
    double off = std::fabs(wrench.getForce()[1] - force.model_n[0]) + std::fabs(wrench.getForce()[2] - force.model_n[2]);
    if (!(off < 1e-3) || wrench.getTorque()[0] != 0) return fail("the wrench differs from the force, N", off);

    component.setLock(true);
    force = feel(component, -10);
    if (force.size_n != 0) return fail("a locked component has a force, N", force.size_n);
    component.setLock(false);
    for (int tick = 0; tick < 700; ++tick) force = feel(component, -10);
    if (component.phase() != PALPATE_PHASE_ACTIVE) return fail("not active after the lock", component.phase());
    feel(component, 900);
    for (int tick = 0; tick < 20; ++tick) force = feel(component, -10);
    if (component.phase() != PALPATE_PHASE_SAFE_ZERO || force.size_n != 0) return fail("a jump of the hand keeps the force, N", force.size_n);
    component.d_activate.setValue(false);
    feel(component, 10);
    component.d_activate.setValue(true);
    feel(component, 10);
    if (component.phase() != PALPATE_PHASE_ACTIVE) return fail("not armed again after the fault", component.phase());
    return 0;
}
