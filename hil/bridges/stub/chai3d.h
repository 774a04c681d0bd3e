// A stand-in for the parts of CHAI3D 3.x that the bridges call, with one scripted device; signatures only.
//
// The hand above the device repeats a stroke along a line through the centre of the workspace:
//
//     0.0 s  10 mm outside      0.1 to 0.3 s  presses the first button
//     0.9 to 1.7 s  moves 10 mm inside, waits until 2.0 s, is outside again at 2.8 s; the stroke lasts 3 s
//
// PALPATE_FAKE_NORMAL=X,Y,Z   direction to the outside, in axes of CHAI3D
// PALPATE_FAKE_LOG=FILE       a line for every force: time us, position m, force N
// PALPATE_FAKE_MAX_N=F        largest force of the device, 5 N if not given
// PALPATE_FAKE_FAIL_S=S       the position cannot be read from this time on
#pragma once

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>
#include <thread>

namespace chai3d {

// CHAI3D has a variable of this name, which is a macro of termios.h.
inline int nameOfAMacro() { int B0 = 1; return B0; }

class cVector3d {
public:
    cVector3d(double x = 0, double y = 0, double z = 0) : x_(x), y_(y), z_(z) {}
    double x() const { return x_; }
    double y() const { return y_; }
    double z() const { return z_; }

private:
    double x_, y_, z_;
};

struct cHapticDeviceInfo {
    std::string m_modelName = "Stub";
    double m_maxLinearForce = 5, m_maxLinearStiffness = 2000, m_workspaceRadius = 0.06;
};

class cGenericHapticDevice {
public:
    virtual ~cGenericHapticDevice() = default;
    virtual bool open() { return false; }
    virtual bool close() { return false; }
    virtual bool calibrate(bool a_forceCalibration = false) { return !a_forceCalibration; }
    virtual bool getPosition(cVector3d &) { return false; }
    virtual bool getUserSwitches(unsigned int &) { return false; }
    virtual bool setForceAndTorqueAndGripperForce(const cVector3d &, const cVector3d &, const double) { return false; }
    bool setForce(const cVector3d &a_force) { return setForceAndTorqueAndGripperForce(a_force, cVector3d(), 0.0); }
    cHapticDeviceInfo getSpecifications() { return m_specifications; }
    cHapticDeviceInfo m_specifications;
};
using cGenericHapticDevicePtr = std::shared_ptr<cGenericHapticDevice>;

class ScriptedDevice : public cGenericHapticDevice {
public:
    ScriptedDevice()
    {
        m_specifications.m_maxLinearForce = number("PALPATE_FAKE_MAX_N", 5);
        const char *normal = std::getenv("PALPATE_FAKE_NORMAL");
        if (normal == nullptr || std::sscanf(normal, "%lf,%lf,%lf", &normal_[0], &normal_[1], &normal_[2]) != 3) normal_[2] = 1;
    }
    ~ScriptedDevice() override { ScriptedDevice::close(); }

    bool open() override
    {
        start_us_ = clockUs();
        const char *path = std::getenv("PALPATE_FAKE_LOG");
        log_ = std::fopen(path != nullptr ? path : "/dev/null", "w");
        if (log_ != nullptr) std::setvbuf(log_, nullptr, _IOLBF, 0);
        return log_ != nullptr;
    }
    bool close() override
    {
        if (log_ != nullptr) std::fclose(log_);
        log_ = nullptr;
        return true;
    }
    bool calibrate(bool) override { return true; }
    bool getPosition(cVector3d &a_position) override
    {
        a_position = place();
        return log_ != nullptr && seconds() < number("PALPATE_FAKE_FAIL_S", 1e9);
    }
    bool getUserSwitches(unsigned int &a_userSwitches) override
    {
        double s = std::fmod(seconds(), 3.0);
        a_userSwitches = s > 0.1 && s < 0.3 ? 1 : 0;
        return log_ != nullptr;
    }
    bool setForceAndTorqueAndGripperForce(const cVector3d &f, const cVector3d &, const double) override
    {
        if (log_ == nullptr) return false;
        cVector3d p = place();
        std::fprintf(log_, "%lld %.7f %.7f %.7f %.5f %.5f %.5f\n", clockUs(), p.x(), p.y(), p.z(), f.x(), f.y(), f.z());
        // About the time of a USB transaction.
        std::this_thread::sleep_for(std::chrono::microseconds(150));
        return true;
    }

private:
    static double number(const char *name, double otherwise)
    {
        const char *text = std::getenv(name);
        return text != nullptr ? std::atof(text) : otherwise;
    }
    static long long clockUs()
    {
        auto since = std::chrono::system_clock::now().time_since_epoch();
        return std::chrono::duration_cast<std::chrono::microseconds>(since).count();
    }
    double seconds() const { return 1e-6 * static_cast<double>(clockUs() - start_us_); }
    cVector3d place() const
    {
        double s = std::fmod(seconds(), 3.0);
        double down = std::clamp(std::min(s - 0.9, 2.8 - s) / 0.8, 0.0, 1.0), height_m = 0.01 - 0.02 * down;
        return cVector3d(height_m * normal_[0], height_m * normal_[1], height_m * normal_[2]);
    }
    double normal_[3] = {0, 0, 0};
    long long start_us_ = 0;
    std::FILE *log_ = nullptr;
};

class cHapticDeviceHandler {
public:
    virtual ~cHapticDeviceHandler() = default;
    unsigned int getNumDevices() { return 1; }
    bool getDevice(cGenericHapticDevicePtr &a_device, unsigned int a_index = 0)
    {
        if (a_index == 0) a_device = std::make_shared<ScriptedDevice>();
        return a_index == 0;
    }
};

enum CThreadPriority { CTHREAD_PRIORITY_GRAPHICS, CTHREAD_PRIORITY_HAPTICS };

class cThread {
public:
    void start(void (*a_function)(void), const CThreadPriority) { std::thread(a_function).detach(); }
};

inline void cSleepMs(const unsigned int a_interval) { std::this_thread::sleep_for(std::chrono::milliseconds(a_interval)); }

} // namespace chai3d
