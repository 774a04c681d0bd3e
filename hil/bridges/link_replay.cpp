// Plays a script to the device's end of the link and prints what it does, for a comparison with the Rust crate.
//
//     link_replay < SCRIPT      made by `cargo run -p palpate-link --example sessions -- SCRIPT EXPECTED`
//
// step NOW_US E0 E1 E2 BUTTONS HOMED FAULT  ->  torque T0 T1 T2
// read NOW_US HEX                           ->  answer HEX
#include <cinttypes>
#include <cstdio>
#include <cstdlib>

#include "palpate_link.h"

int main()
{
    palpate_link::Device device({{4096, 4096, 4096}, {500000, 400000, 250000}, 10000, 17, 1, 20000, 3});
    char word[8], hex[512];
    uint64_t now_us;
    while (std::scanf("%7s %" SCNu64, word, &now_us) == 2) {
        if (word[0] == 's') {
            palpate_link::Inputs inputs;
            int homed, fault;
            unsigned buttons;
            if (std::scanf("%d %d %d %u %d %d", &inputs.encoders[0], &inputs.encoders[1], &inputs.encoders[2], &buttons,
                           &homed, &fault)
                != 6) {
                return 1;
            }
            inputs.buttons = static_cast<uint8_t>(buttons);
            inputs.homed = homed != 0;
            inputs.fault = fault != 0;
            palpate_link::Axes torque_unm = device.step(now_us, inputs);
            std::printf("torque %d %d %d\n", torque_unm[0], torque_unm[1], torque_unm[2]);
        } else {
            if (std::scanf("%511s", hex) != 1) return 1;
            std::printf("answer ");
            for (const char *at = hex; at[0] != '\0' && at[1] != '\0'; at += 2) {
                const char byte[] = {at[0], at[1], '\0'};
                palpate_link::Bytes answer = device.receive(now_us, static_cast<uint8_t>(std::strtoul(byte, nullptr, 16)));
                for (size_t i = 0; i < answer.size; ++i) std::printf("%02x", answer.data[i]);
            }
            std::printf("\n");
        }
    }
    return 0;
}
