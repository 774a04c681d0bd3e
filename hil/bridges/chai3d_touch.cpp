// Feels an organ of Palpate from the haptic thread of a CHAI3D program, through the C functions.
//
//     chai3d_touch [--device N] [--calibrate] [--at X,Y,Z] [--scale S] [--max-force N] ORGAN.blob
//
// --at is the place of the model (m) in the centre of the device's workspace, the first active node if not
// given; --scale the metres of the model per metre of the device; --max-force a limit below that of the device,
// 1 N for the first touch. --calibrate lets the device find its home: some move their arm by themselves. The first button arms, and clears a fault; then press it again. Ctrl-C ends. The force
// is zero before arming, after every fault and at the end. With the flags of CHAI3D's own build in $CHAI3D:
//
//     c++ -std=c++17 -I firmware-like-core/c-api/include hil/bridges/chai3d_touch.cpp $CHAI3D
//         -L target/firmware -lpalpate_c -o chai3d_touch
//
// No second process guards this one: if it is killed or stopped, the rule of the device itself decides.
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "chai3d.h"
#include "palpate.h"

using chai3d::cVector3d;

namespace {

// A blob, its organ and a controller, in memory that the library uses in place.
class Organ {
public:
    // Returns what is wrong, or an empty text.
    std::string open(const char *path)
    {
        std::ifstream file(path, std::ios::binary);
        std::vector<char> bytes((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
        if (!file.is_open() || bytes.empty()) return "cannot be read";
        blob_ = words(bytes.size());
        std::copy(bytes.begin(), bytes.end(), reinterpret_cast<char *>(blob_.get()));
        organ_memory_ = words(palpate_organ_size());
        PalpateProblem problem;
        if (palpate_organ_open(raw(organ_memory_), palpate_organ_size(), raw(blob_), bytes.size(), &organ, &problem) != PALPATE_STATUS_OK) {
            return palpate_status_text(problem.status);
        }
        PalpateOrganInfo info;
        palpate_organ_info(organ, &info);
        // Nothing bounds the error of a blob without a certificate.
        return info.certified ? "" : "has no certificate: pack it again";
    }

    std::string openController(const PalpateConfig &config)
    {
        controller_memory_ = words(palpate_controller_size());
        PalpateProblem problem;
        if (palpate_controller_open(raw(controller_memory_), palpate_controller_size(), organ, &config, &controller, &problem)
            != PALPATE_STATUS_OK) {
            return std::string(palpate_status_text(problem.status)) + " " + problem.what;
        }
        size_t count = palpate_surface_words(organ);
        surface_.resize(count);
        if (count > 0 && palpate_controller_on_surface(controller, surface_.data(), count) != PALPATE_STATUS_OK) {
            return "its surface cannot be used";
        }
        return "";
    }

    const PalpateOrgan *organ = nullptr;
    PalpateController *controller = nullptr;

private:
    struct alignas(PALPATE_ALIGNMENT) Word {
        unsigned char bytes[PALPATE_ALIGNMENT];
    };
    using Words = std::unique_ptr<Word[]>;
    static Words words(size_t bytes) { return Words(new Word[bytes / sizeof(Word) + 1]()); }
    static uint8_t *raw(const Words &words) { return reinterpret_cast<uint8_t *>(words.get()); }

    Words blob_, organ_memory_, controller_memory_;
    std::vector<uint32_t> surface_;
};

// What the haptic callback, which has no arguments, needs; written before it starts.
struct Session {
    chai3d::cGenericHapticDevicePtr device;
    PalpateController *controller = nullptr;
    double centre_m[3] = {0, 0, 0}, scale = 1;
    // For the display.
    std::atomic<float> depth_m{0}, force_n{0};
    std::atomic<int> phase{PALPATE_PHASE_DISARMED}, fault{PALPATE_FAULT_NONE};
    std::atomic<bool> running{true}, finished{false}, zeroed{false};
} session;

uint64_t nowUs()
{
    auto since = std::chrono::steady_clock::now().time_since_epoch();
    return static_cast<uint64_t>(std::chrono::duration_cast<std::chrono::microseconds>(since).count());
}

// The haptic callback: position in, force out. CHAI3D has x towards the user, y right, z up; the model x right,
// y up, z towards the user.
void updateHaptics()
{
    // A button that is held at the start does not arm.
    bool was_pressed = true;
    while (session.running) {
        cVector3d at;
        unsigned int switches = 0;
        bool good = session.device->getPosition(at) && session.device->getUserSwitches(switches);
        bool pressed = good ? (switches & 1) != 0 : was_pressed;
        if (pressed && !was_pressed && session.phase == PALPATE_PHASE_SAFE_ZERO) palpate_reset(session.controller);
        else if (pressed && !was_pressed && session.phase == PALPATE_PHASE_DISARMED) palpate_arm(session.controller);
        was_pressed = pressed;

        uint64_t now_us = nowUs();
        const double device_m[3] = {at.y(), at.z(), at.x()};
        PalpateSample sample{};
        sample.t_us = now_us;
        sample.buttons = switches;
        for (int axis = 0; axis < 3; ++axis) {
            sample.position_m[axis] = static_cast<float>(session.centre_m[axis] + session.scale * device_m[axis]);
        }
        PalpateCommand command;
        // Without a position the controller holds its force for a few ticks and then latches a fault. Should the
        // call itself fail, it writes zero.
        palpate_tick(session.controller, now_us, good ? &sample : nullptr, &command);

        const float *n = command.hand_force_n;
        if (!session.device->setForce(cVector3d(n[2], n[0], n[1]))) palpate_disarm(session.controller);
        session.force_n = std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        const float *d = command.displacement_m;
        session.depth_m = std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        session.phase = command.phase;
        session.fault = command.fault;
        // A device whose calls return at once must not be asked more often than 4 kHz.
        if (nowUs() - now_us < 250) std::this_thread::sleep_for(std::chrono::microseconds(250));
    }
    session.zeroed = session.device->setForce(cVector3d(0, 0, 0));
    session.finished = true;
}

int fail(const std::string &what)
{
    std::fprintf(stderr, "chai3d_touch: %s\n", what.c_str());
    return 1;
}

// The controller's limits are those of the device. CHAI3D states the stiffness of a bare spring at 1 kHz; without
// a measured damping, 1000 N/m at the hand is the usual cap.
PalpateConfig configure(const PalpateOrgan *organ, const chai3d::cHapticDeviceInfo &info, double scale, double max_force_n)
{
    PalpateConfig config;
    PalpateOrganInfo about;
    PalpateSpaceInfo space;
    palpate_organ_info(organ, &about);
    palpate_space_info(organ, 0, &space);
    // The recommended method, if the blob has it.
    uint32_t method = PALPATE_METHOD_ENERGY;
    for (uint32_t other = 0; (space.methods >> method & 1) == 0 && other < 8; ++other) {
        if ((space.methods >> other & 1) != 0) method = other;
    }
    palpate_config(method, &config);
    config.max_force_n = std::min({config.max_force_n, about.max_force_n, static_cast<float>(std::min(max_force_n, info.m_maxLinearForce))});
    config.max_stiffness_n_m = static_cast<float>(std::min(1000.0, info.m_maxLinearStiffness) / scale);
    config.workspace_scale = static_cast<float>(scale);
    // The first button arms, so it does not grasp as well; a second one does.
    config.grasp_button = 2;
    return config;
}

void show()
{
    static const char *const phases[] = {"disarmed: press the button", "active", "FAULT: press the button, then again"};
    std::printf("depth %6.2f mm  force %6.3f N  %s", 1e3 * session.depth_m, static_cast<double>(session.force_n), phases[session.phase]);
    std::printf(session.fault != PALPATE_FAULT_NONE ? " (%d)\n" : "\n", session.fault.load());
    std::fflush(stdout);
}

} // namespace

int main(int argc, char **argv)
{
    unsigned int number = 0;
    const char *path = nullptr;
    double max_force_n = 100;
    bool placed = false, calibrates = false, understood = true;
    for (int i = 1; i < argc; ++i) {
        std::string word = argv[i];
        bool more = i + 1 < argc;
        if (word == "--device" && more) number = static_cast<unsigned int>(std::atoi(argv[++i]));
        else if (word == "--scale" && more) session.scale = std::atof(argv[++i]);
        else if (word == "--max-force" && more) max_force_n = std::atof(argv[++i]);
        else if (word == "--at" && more)
            placed = std::sscanf(argv[++i], "%lf,%lf,%lf", &session.centre_m[0], &session.centre_m[1], &session.centre_m[2]) == 3;
        else if (word == "--calibrate") calibrates = true;
        else if (word[0] != '-' && path == nullptr) path = argv[i];
        else understood = false;
    }
    if (path == nullptr || !understood || !(session.scale > 0 && max_force_n > 0)) {
        std::fprintf(stderr, "usage: chai3d_touch [--device N] [--calibrate] [--at X,Y,Z] [--scale S] [--max-force N] ORGAN.blob\n");
        return 2;
    }
    Organ organ;
    std::string wrong = organ.open(path);
    if (!wrong.empty()) return fail(std::string(path) + ": " + wrong);
    PalpateSpaceInfo space;
    if (palpate_space_info(organ.organ, 0, &space) != PALPATE_STATUS_OK) return fail("the organ has no active node");
    for (int axis = 0; !placed && axis < 3; ++axis) session.centre_m[axis] = space.rest_position_m[axis];

    chai3d::cHapticDeviceHandler handler;
    if (number >= handler.getNumDevices()) return fail("CHAI3D lists " + std::to_string(handler.getNumDevices()) + " devices");
    if (!handler.getDevice(session.device, number) || !session.device->open()) return fail("CHAI3D cannot open the device");
    if (calibrates && !session.device->calibrate()) return fail("the device is not calibrated");
    wrong = organ.openController(configure(organ.organ, session.device->getSpecifications(), session.scale, max_force_n));
    if (!wrong.empty()) return fail(std::string(path) + ": " + wrong);
    session.controller = organ.controller;

    static volatile std::sig_atomic_t stopped = 0;
    for (int signal : {SIGINT, SIGTERM}) std::signal(signal, [](int) { stopped = 1; });
    chai3d::cThread thread;
    thread.start(updateHaptics, chai3d::CTHREAD_PRIORITY_HAPTICS);
    while (stopped == 0) {
        show();
        chai3d::cSleepMs(100);
    }
    // The haptic thread itself sends the last zero, so that no force can follow it.
    session.running = false;
    while (!session.finished) chai3d::cSleepMs(1);
    session.device->close();
    return session.zeroed ? 0 : fail("the last zero force was not accepted");
}
