/* Presses into an organ and releases it: Palpate in a simulation in C.
 *
 *     press FILE.blob [METHOD]
 *
 * Prints the force every 50 ms. Exits with 0 if the organ pushed back and there was no fault. */
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "palpate.h"

/* Reads a whole file to an address aligned for a blob. Returns NULL after an error message. */
static void *load(const char *path, size_t *size)
{
    FILE *file = fopen(path, "rb");
    uint8_t *bytes = NULL;
    size_t room = 1 << 16;
    *size = 0;
    if (file == NULL) {
        fprintf(stderr, "press: cannot open %s: %s\n", path, strerror(errno));
        return NULL;
    }
    for (;;) {
        /* Doubles the buffer, because the length is not known in advance for a pipe. */
        uint8_t *larger = aligned_alloc(PALPATE_ALIGNMENT, room);
        if (larger == NULL) {
            break;
        }
        if (bytes != NULL) {
            memcpy(larger, bytes, *size);
        }
        free(bytes);
        bytes = larger;
        *size += fread(bytes + *size, 1, room - *size, file);
        if (*size < room) {
            break;
        }
        room *= 2;
    }
    if (ferror(file) || bytes == NULL) {
        fprintf(stderr, "press: cannot read %s: %s\n", path, strerror(errno));
        free(bytes);
        bytes = NULL;
    }
    fclose(file);
    return bytes;
}

static void *state(size_t size)
{
    size_t rounded = (size + PALPATE_ALIGNMENT - 1) / PALPATE_ALIGNMENT * PALPATE_ALIGNMENT;
    return aligned_alloc(PALPATE_ALIGNMENT, rounded);
}

static int refused(const PalpateProblem *problem)
{
    fprintf(stderr, "press: %s", palpate_status_text(problem->status));
    if (problem->what[0] != '\0') {
        fprintf(stderr, " (%s)", problem->what);
    }
    fprintf(stderr, "\n");
    return 1;
}

int main(int argc, char **argv)
{
    if (argc < 2 || argc > 3) {
        fprintf(stderr, "usage: press FILE.blob [METHOD]\n");
        return 2;
    }
    uint32_t method = PALPATE_METHOD_ENERGY;
    if (argc > 2) {
        char *end;
        unsigned long number = strtoul(argv[2], &end, 10);
        if (*end != '\0' || end == argv[2] || number > PALPATE_METHOD_ENERGY) {
            fprintf(stderr, "press: METHOD is a number from 0 to %d (see PalpateMethod), not %s\n", PALPATE_METHOD_ENERGY, argv[2]);
            return 2;
        }
        method = (uint32_t)number;
    }

    size_t blob_size;
    void *blob = load(argv[1], &blob_size);
    void *organ_memory = state(palpate_organ_size());
    void *controller_memory = state(palpate_controller_size());
    if (blob == NULL || organ_memory == NULL || controller_memory == NULL) {
        return 1;
    }

    const PalpateOrgan *organ;
    PalpateController *controller;
    PalpateProblem problem;
    PalpateOrganInfo info;
    PalpateSpaceInfo space;
    PalpateConfig config;
    if (palpate_organ_open(organ_memory, palpate_organ_size(), blob, blob_size, &organ, &problem) != PALPATE_STATUS_OK) {
        return refused(&problem);
    }
    if (palpate_organ_info(organ, &info) != PALPATE_STATUS_OK || palpate_space_info(organ, 0, &space) != PALPATE_STATUS_OK) {
        fprintf(stderr, "press: the organ has no active node\n");
        return 1;
    }
    printf("%s, %s: %u space(s), %u vertices%s\n", info.scene, info.law, info.spaces, info.vertices,
           info.certified ? ", certified" : "");

    palpate_config(method, &config);
    if (info.max_force_n < config.max_force_n) {
        config.max_force_n = info.max_force_n;
    }
    if (palpate_controller_open(controller_memory, palpate_controller_size(), organ, &config, &controller, &problem)
        != PALPATE_STATUS_OK) {
        return refused(&problem);
    }

    /* One second at 1 kHz: from 2 mm above the surface to 8 mm below and back. */
    float most_n = 0;
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
        if (command.phase != PALPATE_PHASE_ACTIVE) {
            fprintf(stderr, "press: fault %d\n", command.fault);
            return 1;
        }
        float out_n = 0;
        for (int axis = 0; axis < 3; ++axis) {
            out_n += command.hand_force_n[axis] * space.outward_normal[axis];
        }
        most_n = out_n > most_n ? out_n : most_n;
        if (tick % 50 == 0) {
            printf("%4u ms  depth %6.2f mm  hand %6.3f N outward%s\n", (unsigned)tick, 1e3 * depth_m, out_n,
                   command.engaged < 0 ? "  (free)" : "");
        }
    }

    PalpateSurface surface;
    palpate_surface(organ, &surface);
    float(*moved)[3] = calloc(surface.vertices, sizeof *moved);
    const float in_5_mm[3] = {-0.005f * space.outward_normal[0], -0.005f * space.outward_normal[1],
                              -0.005f * space.outward_normal[2]};
    PalpateStatus drawn = palpate_displacements(organ, 0, &in_5_mm, moved, surface.vertices);
    printf("surface displacements: %s\n", palpate_status_text(drawn));

    free(moved);
    free(controller_memory);
    free(organ_memory);
    free(blob);
    return most_n > 0.1f ? 0 : 1;
}
