// Makes a CHAI3D device a device of Palpate: the device link on a pseudo terminal.
//
//     chai3d_device [--device N] [--calibrate] PROFILE.toml
//     palpate run organ.blob --device link:/dev/pts/N --profile PROFILE.toml
//
// The program prints the second command and writes the profile if it does not exist. Set
// `mapping.model_origin_m` in it to the place of the organ that lies in the centre of the workspace.
// --calibrate lets the device find its home: some move their arm by themselves. Without it the device must
// be calibrated already.
//
// The host sees a gantry in its own axes: x right, y up, z towards the user. CHAI3D has x towards the user,
// y right, z up. This side keeps the rules of the link: a torque ends after its validity, the watchdog and
// every failed call latch zero force until a new session. It cannot act while a call of CHAI3D blocks, or
// after a kill -9; then the rule of the device itself decides. Start it with `chrt -f 50`. With the flags of
// CHAI3D's own build in $CHAI3D:
//
//     c++ -std=c++17 hil/bridges/chai3d_device.cpp $CHAI3D -o chai3d_device
#include <cerrno>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fcntl.h>
#include <poll.h>
#include <string>
#include <unistd.h>

// Before termios.h, whose macro B0 is the name of a variable in CHAI3D.
#include "chai3d.h"

#include <termios.h>

#include "palpate_link.h"

using chai3d::cVector3d;

namespace {

// A fine gantry: a count is 1 um, and 1 uN m is 0.06 mN.
constexpr double METRES_PER_TURN = 0.1, N_M_PER_N = METRES_PER_TURN / (2 * 3.14159265358979);
constexpr uint32_t COUNTS_PER_TURN = 100000;
constexpr uint16_t WATCHDOG_US = 10000;
constexpr double MAX_SPEED_M_S = 3;

volatile std::sig_atomic_t stopped = 0;

uint64_t nowUs()
{
    timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return static_cast<uint64_t>(now.tv_sec) * 1000000 + static_cast<uint64_t>(now.tv_nsec) / 1000;
}

int fail(const std::string &what)
{
    std::fprintf(stderr, "chai3d_device: %s\n", what.c_str());
    return 1;
}

// Position of the handle as counts of the three axes. False if it is no number or out of any reach.
bool counts(const cVector3d &position_m, palpate_link::Axes &encoders)
{
    const double ours_m[3] = {position_m.y(), position_m.z(), position_m.x()};
    for (int axis = 0; axis < 3; ++axis) {
        if (!(std::fabs(ours_m[axis]) < 10)) return false;
        encoders[axis] = static_cast<int32_t>(std::lround(ours_m[axis] / METRES_PER_TURN * COUNTS_PER_TURN));
    }
    return true;
}

// Force for the hand in the axes of CHAI3D, shortened to the limit of the device.
cVector3d force(const palpate_link::Axes &torque_unm, double max_force_n)
{
    double ours_n[3], sum = 0;
    for (int axis = 0; axis < 3; ++axis) {
        ours_n[axis] = 1e-6 * torque_unm[axis] / N_M_PER_N;
        sum += ours_n[axis] * ours_n[axis];
    }
    double share = sum > max_force_n * max_force_n ? max_force_n / std::sqrt(sum) : 1;
    return cVector3d(share * ours_n[2], share * ours_n[0], share * ours_n[1]);
}

// Writes the profile of the device unless the file exists: it may hold figures of the user.
bool writeProfile(const char *path, const chai3d::cHapticDeviceInfo &info)
{
    int file = open(path, O_WRONLY | O_CREAT | O_EXCL, 0666);
    if (file < 0) return errno == EEXIST;
    std::FILE *out = fdopen(file, "w");
    std::string name = info.m_modelName;
    for (char &letter : name) {
        if (letter == '"' || letter == '\\' || letter < ' ') letter = '_';
    }
    std::fprintf(out,
                 "# Limits and workspace as CHAI3D states them; no damping is stated, so the default cap of the stiffness holds.\n"
                 "name = \"%s by CHAI3D\"\n\n"
                 "[limits]\nmax_force_n = %.4f\nmax_stiffness_n_m = %.1f\nrate_hz = 1000.0\n\n"
                 "[link]                       # assumed: a USB transaction each way, and a cycle of the bridge\n"
                 "position_delay_us = 1000\nforce_delay_us = 1000\n\n"
                 "[capstan]\nmetres_per_turn = [%.1f, %.1f, %.1f]\norigin_m = [0.0, 0.0, 0.0]\n\n"
                 "[workspace]\nradius_m = %.4f\n\n"
                 "[mapping]\nscale = 1.0\nmodel_origin_m = [0.0, 0.0, 0.0]\n",
                 name.c_str(), info.m_maxLinearForce, info.m_maxLinearStiffness, METRES_PER_TURN, METRES_PER_TURN,
                 METRES_PER_TURN, info.m_workspaceRadius);
    return std::fclose(out) == 0;
}

// A raw pseudo terminal. The host's end stays open here, because the line would otherwise close between two
// sessions.
int openTerminal(std::string &name, int &host_end)
{
    int line = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
    if (line < 0 || grantpt(line) != 0 || unlockpt(line) != 0 || ptsname(line) == nullptr) return -1;
    name = ptsname(line);
    host_end = open(name.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK);
    termios settings;
    if (host_end < 0 || tcgetattr(host_end, &settings) != 0) return -1;
    cfmakeraw(&settings);
    return tcsetattr(host_end, TCSANOW, &settings) == 0 ? line : -1;
}

// Reads what the host has sent and writes the answers. False if the line is gone.
bool serve(int line, palpate_link::Device &link)
{
    uint8_t chunk[256];
    ssize_t count = read(line, chunk, sizeof chunk);
    for (ssize_t i = 0; i < count; ++i) {
        palpate_link::Bytes answer = link.receive(nowUs(), chunk[i]);
        // An answer that does not fit at once is lost: the host asks again.
        if (answer.size > 0 && write(line, answer.data, answer.size) < 0 && errno != EAGAIN) return false;
    }
    return count >= 0 || errno == EAGAIN || errno == EINTR;
}

const char *text(palpate_link::Phase phase)
{
    switch (phase) {
    case palpate_link::Phase::Idle: return "no session";
    case palpate_link::Phase::Linked: return "session open, no force";
    case palpate_link::Phase::Homing: return "homing";
    case palpate_link::Phase::Enabled: return "ENABLED";
    case palpate_link::Phase::Faulted: return "fault: no force until a new session";
    }
    return "";
}

// The control loop, until a signal or until the line is gone.
bool run(chai3d::cGenericHapticDevice &device, int line, const chai3d::cHapticDeviceInfo &info)
{
    auto limit_unm = static_cast<uint32_t>(std::lround(1e6 * info.m_maxLinearForce * N_M_PER_N));
    palpate_link::Info about{{COUNTS_PER_TURN, COUNTS_PER_TURN, COUNTS_PER_TURN},
                             {limit_unm, limit_unm, limit_unm},
                             WATCHDOG_US,
                             0,
                             1,
                             static_cast<uint32_t>(MAX_SPEED_M_S / METRES_PER_TURN * COUNTS_PER_TURN),
                             static_cast<uint32_t>(nowUs())};
    palpate_link::Device link(about);
    palpate_link::Phase shown = palpate_link::Phase::Idle;
    palpate_link::Inputs inputs;
    bool force_failed = false;
    while (stopped == 0) {
        pollfd waits{line, POLLIN, 0};
        poll(&waits, 1, 1);

        cVector3d position_m;
        unsigned int switches = 0;
        bool good = device.getPosition(position_m) && counts(position_m, inputs.encoders) && device.getUserSwitches(switches);
        inputs.buttons = static_cast<uint8_t>(switches);
        // CHAI3D's positions are absolute, so a device that answers is at home with its counts.
        inputs.homed = good;
        inputs.fault = !good || force_failed;
        link.step(nowUs(), inputs);
        bool connected = serve(line, link);
        // Once more: a request that has just arrived acts at once, and the clock has gone on.
        palpate_link::Axes torque_unm = link.step(nowUs(), inputs);
        force_failed = !device.setForce(force(torque_unm, info.m_maxLinearForce));
        if (!connected) return false;
        if (link.phase() != shown) {
            shown = link.phase();
            std::fprintf(stderr, "chai3d_device: %s\n", text(shown));
        }
    }
    return true;
}

} // namespace

int main(int argc, char **argv)
{
    unsigned int number = 0;
    bool calibrates = false;
    const char *profile = nullptr;
    for (int i = 1; i < argc; ++i) {
        std::string word = argv[i];
        if (word == "--device" && i + 1 < argc) number = static_cast<unsigned int>(std::atoi(argv[++i]));
        else if (word == "--calibrate") calibrates = true;
        else if (word[0] != '-' && profile == nullptr) profile = argv[i];
        else profile = "", i = argc;
    }
    if (profile == nullptr || profile[0] == '\0') {
        std::fprintf(stderr, "usage: chai3d_device [--device N] [--calibrate] PROFILE.toml\n");
        return 2;
    }

    chai3d::cHapticDeviceHandler handler;
    chai3d::cGenericHapticDevicePtr device;
    if (number >= handler.getNumDevices()) return fail("CHAI3D lists " + std::to_string(handler.getNumDevices()) + " devices");
    if (!handler.getDevice(device, number) || !device->open()) return fail("CHAI3D cannot open the device");
    if (calibrates && !device->calibrate()) return fail("the device is not calibrated");
    chai3d::cHapticDeviceInfo info = device->getSpecifications();
    if (!(info.m_maxLinearForce > 0.01 && info.m_maxLinearForce < 100 && info.m_workspaceRadius > 0)) {
        return fail("CHAI3D states no usable force limit or workspace for this device");
    }
    if (!writeProfile(profile, info)) return fail(std::string(profile) + ": cannot be written");
    std::string name;
    int host_end = -1, line = openTerminal(name, host_end);
    if (line < 0) return fail("no pseudo terminal");

    // SA_RESTART stays off, so that a signal also ends the wait.
    struct sigaction action {};
    action.sa_handler = [](int) { stopped = 1; };
    for (int signal : {SIGINT, SIGTERM, SIGHUP}) sigaction(signal, &action, nullptr);
    std::printf("%s, up to %.1f N. In another shell:\npalpate run BLOB --device link:%s --profile %s\n",
                info.m_modelName.c_str(), info.m_maxLinearForce, name.c_str(), profile);
    std::fflush(stdout);

    bool clean = run(*device, line, info);
    // The last command decides what the motors keep.
    bool zero = device->setForce(cVector3d(0, 0, 0));
    device->close();
    close(host_end);
    close(line);
    return clean && zero ? 0 : fail(clean ? "the last zero force was not accepted" : "the pseudo terminal is gone");
}
