// The device's end of the device link in C++ (docs/formats.md, section 7): frames, and when a torque may act.
//
// The rules and their reasons are those of the crate palpate-link. hil/bridges/check plays random sessions to
// both and compares every byte. For three axes and little-endian processors.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>

namespace palpate_link {

using Axes = std::array<int32_t, 3>;
enum class Phase { Idle, Linked, Homing, Enabled, Faulted };
enum Fault : uint8_t { WATCHDOG, CLOCK, OVERSPEED, HOME_LOST, HARDWARE };
enum Flag : uint8_t { HOMED = 1, HOMING = 2, ENABLED = 4, REFUSED = 8, CLAMPED = 16 };

// Bytes of one message or frame; every one of the protocol fits.
struct Bytes {
    uint8_t data[64];
    size_t size = 0;
    void add(uint8_t byte)
    {
        if (size < sizeof data) data[size++] = byte;
    }
    template <typename T> Bytes &operator<<(const T &value)
    {
        uint8_t raw[sizeof value];
        std::memcpy(raw, &value, sizeof value);
        for (uint8_t byte : raw) add(byte);
        return *this;
    }
    template <typename T> T at(size_t offset) const
    {
        T value;
        std::memcpy(&value, data + offset, sizeof value);
        return value;
    }
};

inline uint32_t crc32(const uint8_t *bytes, size_t size)
{
    uint32_t crc = ~0u;
    for (size_t i = 0; i < size; ++i) {
        crc ^= bytes[i];
        for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ (crc & 1 ? 0xedb88320u : 0);
    }
    return ~crc;
}

inline Bytes encode(Bytes body)
{
    body << crc32(body.data, body.size);
    Bytes frame;
    size_t block = 0;
    frame.add(0);
    for (size_t i = 0; i <= body.size; ++i) {
        if (i < body.size && body.data[i] != 0) {
            frame.add(body.data[i]);
        } else {
            frame.data[block] = static_cast<uint8_t>(frame.size - block);
            block = frame.size;
            frame.add(0);
        }
    }
    return frame;
}

// The message in a frame without its final 00; empty if the frame is damaged.
inline Bytes decode(const Bytes &frame)
{
    Bytes body;
    for (size_t at = 0; at < frame.size;) {
        size_t end = at + frame.data[at];
        if (end > frame.size || frame.size == sizeof frame.data) return {};
        for (++at; at < end; ++at) body.add(frame.data[at]);
        if (at < frame.size) body.add(0);
    }
    if (body.size < 5 || crc32(body.data, body.size - 4) != body.at<uint32_t>(body.size - 4)) return {};
    body.size -= 4;
    return body;
}

struct Info {
    std::array<uint32_t, 3> counts_per_turn, torque_limit_unm;
    uint16_t watchdog_us;
    uint32_t serial, firmware, max_speed_counts_per_s, boot;
};

struct Inputs {
    Axes encoders{};
    uint8_t buttons = 0;
    bool homed = false, fault = false;
};

class Device {
public:
    explicit Device(const Info &info) : info_(info) {}
    Phase phase() const { return phase_; }

    // One reading of the hardware; returns the torques until the next one, micro-newton-metres.
    Axes step(uint64_t now_us, const Inputs &inputs)
    {
        advance(now_us);
        inputs_ = inputs;
        inputs_us_ = now_us;
        if (inputs.fault) latch(HARDWARE);
        if (phase_ == Phase::Enabled && !inputs.homed) latch(HOME_LOST);
        else if (phase_ == Phase::Enabled && isTooFast()) latch(OVERSPEED);
        else if (phase_ == Phase::Homing && home_asked_ && inputs.homed) leave(Phase::Linked);
        else if (phase_ == Phase::Homing) home_asked_ = true;
        if (phase_ != Phase::Enabled) startWindow();
        return held_ && now_us - taken_us_ < valid_us_ ? torque_unm_ : Axes{};
    }

    // One byte of the host's stream; returns the frame of the answer, or an empty one.
    Bytes receive(uint64_t now_us, uint8_t byte)
    {
        if (byte != 0) {
            frame_.add(byte);
            return {};
        }
        Bytes message = decode(frame_), answer;
        frame_.size = 0;
        static const size_t length[] = {7, 9, 9, 9, 27};
        if (message.size > 0 && message.data[0] < 5 && message.size == length[message.data[0]]) answer = reply(now_us, message);
        return answer.size > 0 ? encode(answer) : answer;
    }

private:
    enum Kind : uint8_t { HELLO, ENABLE, DISABLE, HOME, COMMAND };
    static bool isNewer(uint32_t seq, uint32_t than) { return seq != than && seq - than < 0x80000000u; }

    Bytes reply(uint64_t now_us, const Bytes &message)
    {
        advance(now_us);
        Bytes answer;
        uint8_t kind = message.data[0];
        if (kind == HELLO) return hello(message.at<uint16_t>(1), message.at<uint32_t>(3));
        uint32_t session = message.at<uint32_t>(1), seq = message.at<uint32_t>(5);
        if (phase_ == Phase::Idle || session == 0 || session != session_) return answer;
        if (phase_ == Phase::Faulted) return answer << uint8_t{2} << uint8_t{fault_};
        bool newer = isNewer(seq, seq_), done = kind == DISABLE || (kind == HOME && newer);
        if (newer) seq_ = seq;
        if (kind == DISABLE) leave(Phase::Linked);
        else if (kind == ENABLE) done = newer && enable();
        else if (kind == HOME && newer) leave(Phase::Homing);
        else if (kind == COMMAND && newer) done = command(message.at<uint32_t>(9), message.at<Axes>(13), message.at<uint16_t>(25));
        int flags = (inputs_.homed ? HOMED : 0) | (phase_ == Phase::Homing ? HOMING : 0) | (phase_ == Phase::Enabled ? ENABLED : 0)
                    | (done ? 0 : REFUSED) | (held_ && clamped_ ? CLAMPED : 0);
        return answer << uint8_t{1} << seq_ << static_cast<uint32_t>(inputs_us_) << inputs_.encoders << inputs_.buttons
                      << static_cast<uint8_t>(flags);
    }

    void advance(uint64_t now_us)
    {
        bool backwards = now_us < now_us_;
        now_us_ = now_us;
        if (backwards) latch(CLOCK);
        if (phase_ == Phase::Enabled && now_us - std::min(fed_us_, now_us) >= info_.watchdog_us) latch(WATCHDOG);
    }

    Bytes hello(uint16_t version, uint32_t nonce)
    {
        uint32_t session = 0;
        if (version == 1) {
            // The finaliser of MurmurHash3: sessions of one start and of two starts differ.
            session = (nonce ^ (info_.boot << 16 | info_.boot >> 16)) + ++sessions_ * 0x9e3779b9u;
            session = (session ^ session >> 16) * 0x85ebca6bu;
            session = (session ^ session >> 13) * 0xc2b2ae35u;
            session ^= session >> 16;
            while (session == 0 || session == session_) ++session;
            session_ = session;
            seq_ = 0;
            leave(Phase::Linked);
        } else if (phase_ != Phase::Faulted) {
            leave(Phase::Idle);
        }
        return Bytes() << uint8_t{0} << uint16_t{1} << nonce << session << uint8_t{3} << info_.counts_per_turn
                       << info_.torque_limit_unm << info_.watchdog_us << info_.serial << info_.firmware;
    }

    bool enable()
    {
        if (phase_ == Phase::Linked && inputs_.homed && !inputs_.fault) {
            leave(Phase::Enabled);
            fed_us_ = now_us_;
            prompt_ = false;
        }
        return phase_ == Phase::Enabled;
    }

    bool command(uint32_t t_host_us, const Axes &torque_unm, uint16_t valid_for_us)
    {
        if (phase_ != Phase::Enabled) return false;
        uint32_t late_us = lateness(t_host_us);
        if (late_us >= valid_for_us) return false;
        clamp(torque_unm);
        held_ = true;
        valid_us_ = valid_for_us - late_us;
        taken_us_ = fed_us_ = now_us_;
        return true;
    }

    // Excess over the most prompt command since Enable. The clocks may drift by one part in 4096.
    uint32_t lateness(uint32_t t_host_us)
    {
        uint32_t difference_us = static_cast<uint32_t>(now_us_) - t_host_us;
        uint32_t late_us = difference_us - least_us_ - static_cast<uint32_t>((now_us_ - least_at_us_) / 4096);
        if (prompt_ && isNewer(late_us, 0)) return late_us;
        prompt_ = true;
        least_us_ = difference_us;
        least_at_us_ = now_us_;
        return 0;
    }

    // One factor for all axes keeps the direction: the smallest quotient of limit and request, as a fraction.
    void clamp(const Axes &asked_unm)
    {
        uint64_t limit = 1, asked = 1;
        for (int i = 0; i < 3; ++i) {
            uint64_t size = static_cast<uint64_t>(std::abs(int64_t{asked_unm[i]})), most = info_.torque_limit_unm[i];
            if (most * asked < size * limit) limit = most, asked = size;
        }
        for (int i = 0; i < 3; ++i) {
            int64_t size = std::abs(int64_t{asked_unm[i]}) * static_cast<int64_t>(limit) / static_cast<int64_t>(asked);
            torque_unm_[i] = static_cast<int32_t>(asked_unm[i] < 0 ? -size : size);
        }
        clamped_ = torque_unm_ != asked_unm;
    }

    // A window lasts at least 1 ms, because in a shorter one a single count would exceed the speed.
    bool isTooFast()
    {
        uint64_t elapsed_us = now_us_ - window_us_;
        bool found = false;
        for (int i = 0; i < 3; ++i) {
            uint32_t moved = static_cast<uint32_t>(inputs_.encoders[i]) - static_cast<uint32_t>(window_[i]);
            uint64_t size = moved < 0x80000000u ? moved : 0u - moved;
            found |= size * 1000000 > info_.max_speed_counts_per_s * std::max<uint64_t>(elapsed_us, 1000);
        }
        if (elapsed_us >= 1000) startWindow();
        return found;
    }

    void startWindow()
    {
        window_us_ = inputs_us_;
        window_ = inputs_.encoders;
    }

    // The first fault stays until Hello.
    void latch(Fault fault)
    {
        if (phase_ == Phase::Faulted) return;
        leave(Phase::Faulted);
        fault_ = fault;
    }

    // Every change of state removes the torque.
    void leave(Phase phase)
    {
        phase_ = phase;
        held_ = home_asked_ = false;
    }

    Info info_;
    Phase phase_ = Phase::Idle;
    Fault fault_ = HARDWARE;
    Inputs inputs_;
    Bytes frame_;
    Axes torque_unm_{}, window_{};
    bool held_ = false, clamped_ = false, home_asked_ = false, prompt_ = false;
    uint32_t session_ = 0, sessions_ = 0, seq_ = 0, least_us_ = 0;
    uint64_t now_us_ = 0, inputs_us_ = 0, fed_us_ = 0, taken_us_ = 0, valid_us_ = 0, window_us_ = 0, least_at_us_ = 0;
};

} // namespace palpate_link
