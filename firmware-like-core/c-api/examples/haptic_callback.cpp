// Palpate in a haptic callback, as in CHAI3D: a thread that reads a device, computes and sends a force.
//
//     haptic_callback FILE.blob
//
// The device here is a simulated hand that leans on the organ. A real device has the same functions.
#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <functional>
#include <iterator>
#include <memory>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "palpate.h"

using Vector = std::array<double, 3>;

/// The interface of a device in a haptics library.
class HapticDevice {
public:
    virtual ~HapticDevice() = default;
    virtual bool getPosition(Vector &position) = 0;
    virtual bool getUserSwitches(unsigned int &switches) = 0;
    virtual bool setForce(const Vector &force) = 0;
};

/// A hand of 0.2 kg with a spring to a target and a damper; the force of the device pushes it back.
class LeaningHand : public HapticDevice {
public:
    LeaningHand(const Vector &start, const Vector &target) : position_(start), target_(target) {}

    bool getPosition(Vector &position) override
    {
        position = position_;
        return true;
    }

    bool getUserSwitches(unsigned int &switches) override
    {
        switches = 0;
        return true;
    }

    bool setForce(const Vector &force) override
    {
        constexpr double mass_kg = 0.2, spring_n_m = 150, damper_ns_m = 12, step_s = 1e-3;
        for (int axis = 0; axis < 3; ++axis) {
            double sum_n = force[axis] + spring_n_m * (target_[axis] - position_[axis]) - damper_ns_m * velocity_[axis];
            velocity_[axis] += step_s / mass_kg * sum_n;
            position_[axis] += step_s * velocity_[axis];
        }
        return true;
    }

private:
    Vector position_, target_, velocity_{};
};

/// An organ and its controller, with the memory that the library uses.
class Organ {
public:
    explicit Organ(const std::string &path)
    {
        std::ifstream file(path, std::ios::binary);
        if (!file) {
            throw std::runtime_error(path + ": cannot be opened");
        }
        std::vector<char> bytes((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
        blob_ = words(bytes.size());
        std::copy(bytes.begin(), bytes.end(), reinterpret_cast<char *>(blob_.get()));
        organ_memory_ = words(palpate_organ_size());
        controller_memory_ = words(palpate_controller_size());

        PalpateProblem problem;
        if (palpate_organ_open(as_bytes(organ_memory_), palpate_organ_size(), as_bytes(blob_), bytes.size(), &organ_,
                               &problem)
            != PALPATE_STATUS_OK) {
            throw std::runtime_error(path + ": " + palpate_status_text(problem.status));
        }
        PalpateConfig config;
        palpate_config(PALPATE_METHOD_ENERGY, &config);
        PalpateOrganInfo info;
        palpate_organ_info(organ_, &info);
        // The limit of the force is that of the device that the scene was made for.
        config.max_force_n = std::min(config.max_force_n, info.max_force_n);
        if (palpate_controller_open(as_bytes(controller_memory_), palpate_controller_size(), organ_, &config,
                                    &controller_, &problem)
            != PALPATE_STATUS_OK) {
            throw std::runtime_error(path + ": " + palpate_status_text(problem.status) + " " + problem.what);
        }
    }

    PalpateController *controller() { return controller_; }

    PalpateSpaceInfo space(uint32_t number) const
    {
        PalpateSpaceInfo info;
        if (palpate_space_info(organ_, number, &info) != PALPATE_STATUS_OK) {
            throw std::out_of_range("the organ has no space with this number");
        }
        return info;
    }

private:
    struct alignas(PALPATE_ALIGNMENT) Word {
        unsigned char bytes[PALPATE_ALIGNMENT];
    };
    using Words = std::unique_ptr<Word[]>;

    static Words words(size_t bytes) { return Words(new Word[bytes / sizeof(Word) + 1]()); }
    static uint8_t *as_bytes(const Words &words) { return reinterpret_cast<uint8_t *>(words.get()); }

    Words blob_, organ_memory_, controller_memory_;
    const PalpateOrgan *organ_ = nullptr;
    PalpateController *controller_ = nullptr;
};

/// Values shared by the haptic thread and the graphics thread.
struct Shared {
    std::atomic<bool> running{true};
    std::atomic<float> force_n{0};
    std::atomic<int> fault{PALPATE_FAULT_NONE};
};

/// The callback: position in, force out. After a fault the force is zero until the user resets and arms.
static void updateHaptics(HapticDevice &device, PalpateController *controller, Shared &shared)
{
    uint64_t now_us = 0;
    while (shared.running) {
        now_us += 1000;
        Vector position;
        unsigned int switches = 0;
        PalpateSample sample{};
        bool fresh = device.getPosition(position) && device.getUserSwitches(switches);
        sample.t_us = now_us;
        sample.buttons = switches;
        for (int axis = 0; fresh && axis < 3; ++axis) {
            sample.position_m[axis] = static_cast<float>(position[axis]);
        }

        PalpateCommand command;
        palpate_tick(controller, now_us, fresh ? &sample : nullptr, &command);

        const float *f = command.hand_force_n;
        device.setForce({f[0], f[1], f[2]});
        shared.force_n = std::sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]);
        shared.fault = command.fault;
        if (now_us >= 2000000) {
            shared.running = false; // two simulated seconds
        }
    }
    device.setForce({0, 0, 0});
}

int main(int argc, char **argv)
try {
    if (argc != 2) {
        std::fprintf(stderr, "usage: haptic_callback FILE.blob\n");
        return 2;
    }
    Organ organ(argv[1]);
    PalpateSpaceInfo space = organ.space(0);
    Vector start{}, target{};
    for (int axis = 0; axis < 3; ++axis) {
        start[axis] = space.rest_position_m[axis] + 0.005 * space.outward_normal[axis];
        target[axis] = space.rest_position_m[axis] - 0.03 * space.outward_normal[axis];
    }
    LeaningHand hand(start, target);
    Shared shared;
    palpate_arm(organ.controller());
    std::thread haptics(updateHaptics, std::ref(hand), organ.controller(), std::ref(shared));
    haptics.join();

    Vector end;
    hand.getPosition(end);
    double depth_m = 0;
    for (int axis = 0; axis < 3; ++axis) {
        depth_m -= (end[axis] - space.rest_position_m[axis]) * space.outward_normal[axis];
    }
    std::printf("%s: the hand rests %.2f mm deep against %.3f N\n", space.name, 1e3 * depth_m, shared.force_n.load());
    return shared.fault == PALPATE_FAULT_NONE && depth_m > 0 && depth_m < 0.03 && shared.force_n > 0.1 ? 0 : 1;
} catch (const std::exception &error) {
    std::fprintf(stderr, "haptic_callback: %s\n", error.what());
    return 1;
}
