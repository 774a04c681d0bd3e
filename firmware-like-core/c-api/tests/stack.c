/* Stack that the library needs: each call runs on its own stack filled with a pattern; the lowest byte that
 * changed gives the high-water mark.
 *
 *     stack FILE.blob TICKS LIMIT_BYTES
 *
 * Exits with 1 if a tick needs more than the limit. */
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

#include "palpate.h"

enum { STACK = 4 << 20, PAINT = 0xa5 };

static uint8_t *blob, *organ_memory, *controller_memory;
static size_t blob_size;
static const PalpateOrgan *organ;
static PalpateController *controller;
static PalpateSpaceInfo space;
static uint64_t ticks;
static uint32_t method;
static int failed;

static void *nothing(void *unused)
{
    return unused;
}

static void *open_organ(void *unused)
{
    failed |= palpate_organ_open(organ_memory, palpate_organ_size(), blob, blob_size, &organ, NULL) != PALPATE_STATUS_OK;
    return unused;
}

static void *open_controller(void *unused)
{
    PalpateConfig config;
    palpate_config(method, &config);
    failed |= palpate_controller_open(controller_memory, palpate_controller_size(), organ, &config, &controller, NULL)
              != PALPATE_STATUS_OK;
    return unused;
}

/* Samples that press, pull and jump, with missing samples, and a reset after each fault. */
static void *tick(void *unused)
{
    PalpateCommand command;
    uint32_t noise = 1;
    for (uint64_t number = 1; number <= ticks; ++number) {
        PalpateSample sample = {.t_us = 1000 * number, .buttons = (number >> 9) & 1};
        noise = noise * 1664525u + 1013904223u;
        float depth_m = 0.06f * (float)(number % 1024) / 1024.0f - 0.004f;
        for (int axis = 0; axis < 3; ++axis) {
            sample.position_m[axis] = space.rest_position_m[axis] - depth_m * space.outward_normal[axis];
        }
        if (noise >> 20 == 0) {
            sample.position_m[1] = NAN;
        }
        palpate_tick(controller, sample.t_us, noise >> 26 == 5 ? NULL : &sample, &command);
        if (command.phase != PALPATE_PHASE_ACTIVE) {
            palpate_reset(controller);
            palpate_arm(controller);
        }
    }
    return unused;
}

/* Bytes of stack that a thread needs for one function alone. */
static size_t used(void *(*what)(void *))
{
    uint8_t *stack = mmap(NULL, STACK, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    pthread_attr_t attributes;
    pthread_t thread;
    size_t untouched = 0;
    if (stack == MAP_FAILED) {
        failed = 1;
        return 0;
    }
    memset(stack, PAINT, STACK);
    pthread_attr_init(&attributes);
    pthread_attr_setstack(&attributes, stack, STACK);
    if (pthread_create(&thread, &attributes, what, NULL) == 0) {
        pthread_join(thread, NULL);
    } else {
        failed = 1;
    }
    pthread_attr_destroy(&attributes);
    while (untouched < STACK && stack[untouched] == PAINT) {
        ++untouched;
    }
    munmap(stack, STACK);
    return STACK - untouched;
}

int main(int argc, char **argv)
{
    FILE *file = argc == 4 ? fopen(argv[1], "rb") : NULL;
    if (file == NULL || fseek(file, 0, SEEK_END) != 0) {
        fprintf(stderr, "usage: stack FILE.blob TICKS LIMIT_BYTES\n");
        return 2;
    }
    blob_size = (size_t)ftell(file);
    rewind(file);
    ticks = strtoull(argv[2], NULL, 10);
    size_t limit = strtoul(argv[3], NULL, 10);
    blob = aligned_alloc(64, blob_size / 64 * 64 + 64);
    organ_memory = aligned_alloc(64, palpate_organ_size() / 64 * 64 + 64);
    controller_memory = aligned_alloc(64, palpate_controller_size() / 64 * 64 + 64);
    if (fread(blob, 1, blob_size, file) != blob_size) {
        return 2;
    }
    fclose(file);

    size_t thread = used(nothing), opening = used(open_organ) - thread;
    printf("organ %zu bytes of memory, controller %zu; a thread alone needs %zu bytes of stack\n", palpate_organ_size(),
           palpate_controller_size(), thread);
    printf("palpate_organ_open %8zu bytes of stack\n", opening);
    palpate_space_info(organ, 0, &space);
    int worse = 0;
    for (method = 0; method <= PALPATE_METHOD_ENERGY; ++method) {
        if (space.methods >> method & 1) {
            size_t opened = used(open_controller) - thread, bytes = used(tick) - thread;
            printf("method %u: palpate_controller_open %6zu bytes of stack, palpate_tick %6zu in %llu ticks\n", method, opened,
                   bytes, (unsigned long long)ticks);
            worse |= bytes > limit;
        }
    }
    if (worse) {
        fprintf(stderr, "stack: a tick needs more than %zu bytes\n", limit);
    }
    return failed || worse;
}
