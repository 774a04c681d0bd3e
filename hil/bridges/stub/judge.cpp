// Compares the forces in a log of the scripted hand with those of the core at the same places.
//
//     judge BLOB                     prints the place and outward normal of the first active node, model frame
//     judge BLOB LOG MAX_N [WHERE]   checks the log; the workspace's centre lies at the active node
//
// WHERE is `chai3d` (default): places and forces in the axes of CHAI3D; or `mm`: places in millimetres, model
// axes. The map is written here once more, so that an error in a bridge shows.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <vector>

#include "palpate.h"

struct Line {
    long long t_us;
    double at[3], n[3];
};

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static int fail(const char *what, double number)
{
    std::fprintf(stderr, "judge: %s: %g\n", what, number);
    return 1;
}

int main(int argc, char **argv)
{
    if (argc != 2 && argc != 4 && argc != 5) return 2;
    std::ifstream file(argv[1], std::ios::binary);
    std::vector<char> bytes((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
    std::vector<std::max_align_t> memory(palpate_organ_size() / sizeof(std::max_align_t) + 1);
    const PalpateOrgan *organ;
    PalpateSpaceInfo space;
    auto *blob = reinterpret_cast<const uint8_t *>(bytes.data());
    if (palpate_organ_open(reinterpret_cast<uint8_t *>(memory.data()), palpate_organ_size(), blob, bytes.size(), &organ, nullptr)
            != PALPATE_STATUS_OK
        || palpate_space_info(organ, 0, &space) != PALPATE_STATUS_OK) {
        return fail("the blob cannot be opened", 0);
    }
    const float *rest = space.rest_position_m, *out = space.outward_normal;
    if (argc == 2) {
        std::printf("%.7f,%.7f,%.7f %.7f,%.7f,%.7f\n", rest[0], rest[1], rest[2], out[0], out[1], out[2]);
        return 0;
    }
    double max_n = std::atof(argv[3]), normal[3] = {out[0], out[1], out[2]};
    bool millimetres = argc == 5 && std::strcmp(argv[4], "mm") == 0;

    std::FILE *log = std::fopen(argv[2], "r");
    std::vector<Line> lines;
    for (Line read; log != nullptr
                    && std::fscanf(log, "%lld %lf %lf %lf %lf %lf %lf", &read.t_us, &read.at[0], &read.at[1], &read.at[2],
                                   &read.n[0], &read.n[1], &read.n[2])
                           == 7;) {
        Line ours = read;
        for (int axis = 0; axis < 3; ++axis) {
            // x right is CHAI3D's y, y up its z, z towards the user its x.
            ours.at[axis] = millimetres ? 1e-3 * read.at[axis] : read.at[(axis + 1) % 3];
            ours.n[axis] = millimetres ? read.n[axis] : read.n[(axis + 1) % 3];
        }
        lines.push_back(ours);
    }
    if (lines.size() < 1000) return fail("too few lines in the log", static_cast<double>(lines.size()));

    // A stroke counts if its hand was armed: it lasts 3 s and has a force somewhere.
    std::vector<char> armed(static_cast<size_t>((lines.back().t_us - lines[0].t_us) / 3000000 + 1), 0);
    auto stroke = [&](const Line &line) { return static_cast<size_t>((line.t_us - lines[0].t_us) / 3000000); };
    for (const Line &line : lines) {
        double size_n = std::sqrt(dot(line.n, line.n));
        if (!(size_n <= 1.001 * max_n)) return fail("a force beyond the limit, N", size_n);
        if (size_n > 0) armed[stroke(line)] = 1;
    }
    size_t inside = 0, differ = 0;
    double sum_n[10] = {}, core_n[10] = {}, most_n = 0, last_height_m = 1;
    size_t count[10] = {};
    for (const Line &line : lines) {
        double height_m = dot(line.at, normal), outward_n = dot(line.n, normal), size_n = std::sqrt(dot(line.n, line.n));
        bool sinks = height_m <= last_height_m;
        last_height_m = height_m;
        if (!armed[stroke(line)]) continue;
        if (height_m > (sinks ? 0.5e-3 : 3e-3) && size_n > 1e-3) return fail("a force outside of the organ, N", size_n);
        if (height_m > -0.5e-3) continue;
        const float displacement_m[3] = {static_cast<float>(line.at[0]), static_cast<float>(line.at[1]),
                                         static_cast<float>(line.at[2])};
        PalpateForce force;
        palpate_force(organ, 0, PALPATE_METHOD_ENERGY, &displacement_m, &force);
        double h[3] = {force.reaction_n[0], force.reaction_n[1], force.reaction_n[2]}, off[3];
        double expected_n = std::sqrt(dot(h, h)), share = std::min(1.0, max_n / expected_n);
        for (int axis = 0; axis < 3; ++axis) off[axis] = line.n[axis] + share * h[axis];
        ++inside;
        // The place in the log is up to a few milliseconds newer than that of the force.
        differ += std::sqrt(dot(off, off)) > 0.03 + 0.03 * share * expected_n;
        most_n = std::max(most_n, outward_n);
        if (sinks) {
            auto bin = static_cast<size_t>(std::clamp(-1e3 * height_m, 0.0, 9.0));
            sum_n[bin] += outward_n;
            core_n[bin] -= share * dot(h, normal);
            ++count[bin];
        }
    }
    std::printf("depth mm  outward N  core N\n");
    double last_n = -1;
    for (int bin = 0; bin < 10; ++bin) {
        if (count[bin] == 0) continue;
        double mean_n = sum_n[bin] / static_cast<double>(count[bin]);
        std::printf("%2d to %-2d  %9.3f  %6.3f\n", bin, bin + 1, mean_n, core_n[bin] / static_cast<double>(count[bin]));
        if (mean_n < last_n - 0.02) return fail("the force falls with the depth, N", mean_n);
        last_n = mean_n;
    }
    if (inside < 500 || most_n < 0.2) return fail("the hand does not feel the organ, N", most_n);
    double percent = 100.0 * static_cast<double>(differ) / static_cast<double>(inside);
    std::printf("%zu readings inside, up to %.3f N outward, %.2f %% differ from the core\n", inside, most_n, percent);
    return percent <= 5 ? 0 : fail("too many forces differ from the core, %", percent);
}
