/* What C# is compared with: the layout of each structure, and the ticks of ../examples/press.c as bytes.
 *
 *     reference FILE.blob
 *
 * Lines: `struct NAME SIZE`, `field STRUCT NAME OFFSET SIZE`, `tick SAMPLE COMMAND` and `estimate ESTIMATE`, with
 * the bytes in hexadecimal. */
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

#include "palpate.h"

#define STRUCT(type) printf("struct %s %zu\n", #type, sizeof(type))
#define FIELD(type, field) \
    printf("field %s %s %zu %zu\n", #type, #field, offsetof(type, field), sizeof(((type *)0)->field))

static void layout(void)
{
    STRUCT(PalpateConfig);
    FIELD(PalpateConfig, method);
    FIELD(PalpateConfig, grasp_button);
    FIELD(PalpateConfig, capture_radius_m);
    FIELD(PalpateConfig, release_tension_n);
    FIELD(PalpateConfig, release_height_m);
    FIELD(PalpateConfig, friction);
    FIELD(PalpateConfig, grasp_slip);
    FIELD(PalpateConfig, grasp_distance_m);
    FIELD(PalpateConfig, max_force_n);
    FIELD(PalpateConfig, max_slew_n_per_s);
    FIELD(PalpateConfig, ramp_s);
    FIELD(PalpateConfig, fade_s);
    FIELD(PalpateConfig, max_position_m);
    FIELD(PalpateConfig, max_speed_m_s);
    FIELD(PalpateConfig, max_stiffness_n_m);
    FIELD(PalpateConfig, energy_margin_j);
    FIELD(PalpateConfig, energy_damping_n_s_m);
    FIELD(PalpateConfig, energy_fault_j);
    FIELD(PalpateConfig, workspace_scale);
    FIELD(PalpateConfig, position_step_m);
    FIELD(PalpateConfig, force_delay_us);
    FIELD(PalpateConfig, stale_hold_ticks);
    FIELD(PalpateConfig, stale_fault_us);
    FIELD(PalpateConfig, gravity_compensation_n);
    STRUCT(PalpateProblem);
    FIELD(PalpateProblem, status);
    FIELD(PalpateProblem, space);
    FIELD(PalpateProblem, have);
    FIELD(PalpateProblem, need);
    FIELD(PalpateProblem, what);
    STRUCT(PalpateSample);
    FIELD(PalpateSample, t_us);
    FIELD(PalpateSample, position_m);
    FIELD(PalpateSample, buttons);
    STRUCT(PalpateCommand);
    FIELD(PalpateCommand, hand_force_n);
    FIELD(PalpateCommand, reaction_n);
    FIELD(PalpateCommand, displacement_m);
    FIELD(PalpateCommand, hip_m);
    FIELD(PalpateCommand, engaged);
    FIELD(PalpateCommand, coverage);
    FIELD(PalpateCommand, phase);
    FIELD(PalpateCommand, fault);
    FIELD(PalpateCommand, hand_work_j);
    FIELD(PalpateCommand, clamped);
    FIELD(PalpateCommand, damped);
    STRUCT(PalpateOrganInfo);
    FIELD(PalpateOrganInfo, scene);
    FIELD(PalpateOrganInfo, law);
    FIELD(PalpateOrganInfo, max_force_n);
    FIELD(PalpateOrganInfo, spaces);
    FIELD(PalpateOrganInfo, vertices);
    FIELD(PalpateOrganInfo, triangles);
    FIELD(PalpateOrganInfo, certified);
    STRUCT(PalpateSpaceInfo);
    FIELD(PalpateSpaceInfo, name);
    FIELD(PalpateSpaceInfo, node);
    FIELD(PalpateSpaceInfo, methods);
    FIELD(PalpateSpaceInfo, rest_position_m);
    FIELD(PalpateSpaceInfo, outward_normal);
    FIELD(PalpateSpaceInfo, spacing_m);
    FIELD(PalpateSpaceInfo, radius_m);
    FIELD(PalpateSpaceInfo, displacements);
    STRUCT(PalpateForce);
    FIELD(PalpateForce, reaction_n);
    FIELD(PalpateForce, coverage);
    STRUCT(PalpateEstimate);
    FIELD(PalpateEstimate, reaction_n);
    FIELD(PalpateEstimate, stiffness_n_m);
    FIELD(PalpateEstimate, energy_j);
    FIELD(PalpateEstimate, has_energy);
    FIELD(PalpateEstimate, coverage);
    STRUCT(PalpateSurface);
    FIELD(PalpateSurface, x_m);
    FIELD(PalpateSurface, y_m);
    FIELD(PalpateSurface, z_m);
    FIELD(PalpateSurface, triangles);
    FIELD(PalpateSurface, fixed);
    FIELD(PalpateSurface, vertices);
    FIELD(PalpateSurface, triangle_count);
}

static void hex(const void *bytes, size_t size)
{
    for (size_t i = 0; i < size; ++i) {
        printf("%02x", ((const unsigned char *)bytes)[i]);
    }
}

static void *memory(size_t size)
{
    return aligned_alloc(PALPATE_ALIGNMENT, (size + PALPATE_ALIGNMENT - 1) / PALPATE_ALIGNMENT * PALPATE_ALIGNMENT);
}

int main(int argc, char **argv)
{
    enum { LARGEST_BLOB = 1 << 24 };
    FILE *file = argc == 2 ? fopen(argv[1], "rb") : NULL;
    uint8_t *blob = memory(LARGEST_BLOB);
    if (file == NULL || blob == NULL) {
        fprintf(stderr, "usage: reference FILE.blob\n");
        return 2;
    }
    size_t size = fread(blob, 1, LARGEST_BLOB, file);
    fclose(file);

    const PalpateOrgan *organ;
    PalpateController *controller;
    PalpateSpaceInfo space;
    PalpateOrganInfo info;
    PalpateConfig config;
    size_t organ_size = palpate_organ_size(), controller_size = palpate_controller_size();
    if (palpate_organ_open(memory(organ_size), organ_size, blob, size, &organ, NULL) != PALPATE_STATUS_OK
        || palpate_organ_info(organ, &info) != PALPATE_STATUS_OK
        || palpate_space_info(organ, 0, &space) != PALPATE_STATUS_OK
        || palpate_config(PALPATE_METHOD_ENERGY, &config) != PALPATE_STATUS_OK) {
        fprintf(stderr, "reference: the blob was refused\n");
        return 1;
    }
    config.max_force_n = info.max_force_n < config.max_force_n ? info.max_force_n : config.max_force_n;
    if (palpate_controller_open(memory(controller_size), controller_size, organ, &config, &controller, NULL)
        != PALPATE_STATUS_OK) {
        fprintf(stderr, "reference: the configuration was refused\n");
        return 1;
    }

    layout();
    palpate_arm(controller);
    for (uint64_t tick = 0; tick < 1000; ++tick) {
        float along = (float)tick * 1e-3f;
        float depth_m = 0.04f * along * (1 - along) - 0.002f;
        PalpateSample sample = {.t_us = 1000 * tick, .buttons = 0};
        PalpateCommand command;
        for (int axis = 0; axis < 3; ++axis) {
            sample.position_m[axis] = space.rest_position_m[axis] - depth_m * space.outward_normal[axis];
        }
        palpate_tick(controller, sample.t_us, &sample, &command);
        printf("tick ");
        hex(&sample, sizeof sample);
        printf(" ");
        /* Without the bytes after the last field, which have no value. */
        hex(&command, offsetof(PalpateCommand, damped) + 1);
        printf("\n");
    }
    const float displacement_m[3] = {0.001f, -0.002f, 0.003f};
    PalpateEstimate estimate;
    palpate_estimate(organ, 0, PALPATE_METHOD_ENERGY, &displacement_m, &estimate);
    printf("estimate ");
    hex(&estimate, offsetof(PalpateEstimate, has_energy) + 1);
    printf("\n");
    return 0;
}
