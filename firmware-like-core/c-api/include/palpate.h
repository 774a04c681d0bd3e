/* Palpate for C and C++: the reaction force of a soft organ, a thousand times a second.
 *
 * Guide and examples: docs/c-api.md. All state lies in memory of the caller, nothing is allocated, nothing is global, no function
 * blocks. SI units: metres, newtons, joules; times in microseconds. h is the force by the tool ON the body; the hand is given
 * `hand_force_n`, which is -h, ramped and limited.
 *
 * Written by cbindgen from firmware-like-core/c-api; do not edit. To write it again:
 *     PALPATE_WRITE_HEADER=1 cargo test --release -p palpate-c --test header
 */

#ifndef PALPATE_H
#define PALPATE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

// What the memory for organs and controllers must be aligned to, bytes.
#define PALPATE_ALIGNMENT 16

// Longest name with its final zero, bytes.
#define PALPATE_NAME_LEN 72

// Longest `what` with its final zero, bytes.
#define PALPATE_WHAT_LEN 32

// Result of a call. `PALPATE_STATUS_OK` is 0.
typedef enum PalpateStatus {
  // Done.
  PALPATE_STATUS_OK = 0,
  // A pointer that must not be null was, or one was not aligned for what it points to.
  PALPATE_STATUS_NULL_ARGUMENT = 1,
  // The memory for an organ or a controller is null, too small, or not aligned to PALPATE_ALIGNMENT.
  PALPATE_STATUS_MEMORY = 2,
  // No space of this number.
  PALPATE_STATUS_NO_SUCH_SPACE = 3,
  // No method of this number.
  PALPATE_STATUS_NO_SUCH_METHOD = 4,
  // The blob has no table for the method: pack it with `--method`.
  PALPATE_STATUS_MISSING_METHOD = 5,
  // The blob holds no displacements for the eye.
  PALPATE_STATUS_NO_DISPLACEMENTS = 6,
  // A number of the configuration is not finite or not above zero; `what` names it.
  PALPATE_STATUS_CONFIG = 7,
  // Too short for a blob.
  PALPATE_STATUS_TOO_SHORT = 8,
  // The blob does not start at an address divisible by 8.
  PALPATE_STATUS_MISALIGNED = 9,
  // Not a blob.
  PALPATE_STATUS_BAD_MAGIC = 10,
  // The blob ends before its own length (`have`, `need`).
  PALPATE_STATUS_TRUNCATED = 11,
  // The blob goes on after its own length (`have`, `need`).
  PALPATE_STATUS_TOO_LONG = 12,
  // The bytes are not those that were written.
  PALPATE_STATUS_CHECKSUM = 13,
  // Written by a newer version (`need`) than this library reads (`have`).
  PALPATE_STATUS_NEWER_VERSION = 14,
  // A layout version that never was (`have`).
  PALPATE_STATUS_UNKNOWN_VERSION = 15,
  // The header cannot be decoded.
  PALPATE_STATUS_HEADER = 16,
  // The blob has more of `what` (`need`) than this library holds (`have`).
  PALPATE_STATUS_CAPACITY = 17,
  // A number in the header is not what it must be; `what` names it.
  PALPATE_STATUS_VALUE = 18,
  // The grid of a space is not one.
  PALPATE_STATUS_LATTICE = 19,
  // A plane of the blob is wrong; `what` names it.
  PALPATE_STATUS_PLANE = 20,
  // The rest point of a space is not solved or not at rest.
  PALPATE_STATUS_REST_POINT = 21,
} PalpateStatus;

// On what data a force stands.
typedef enum PalpateCoverage {
  // The tool is free: there is no force.
  PALPATE_COVERAGE_NONE = 0,
  // All eight corners of the cell are solved.
  PALPATE_COVERAGE_CELL = 1,
  // All 64 points round it are solved.
  PALPATE_COVERAGE_SUPER_CELL = 2,
  // Scattered data, with solved points at all corners.
  PALPATE_COVERAGE_SCATTERED = 3,
  // Data is missing, or the position is beyond the grid: the out-of-table policy answered, without a jump.
  PALPATE_COVERAGE_EXTRAPOLATED = 4,
} PalpateCoverage;

// What the controller is doing.
typedef enum PalpatePhase {
  // Force zero until armed.
  PALPATE_PHASE_DISARMED = 0,
  // Rendering.
  PALPATE_PHASE_ACTIVE = 1,
  // Force zero after a fault, until palpate_reset and palpate_arm.
  PALPATE_PHASE_SAFE_ZERO = 2,
} PalpatePhase;

// Why the force was taken away.
typedef enum PalpateFault {
  // It was not.
  PALPATE_FAULT_NONE = 0,
  // A position that is NaN or infinite.
  PALPATE_FAULT_NOT_FINITE = 1,
  // No fresh sample for too long.
  PALPATE_FAULT_STALE = 2,
  // The HIP moved faster than a hand.
  PALPATE_FAULT_OVERSPEED = 3,
  // The HIP left the workspace.
  PALPATE_FAULT_WORKSPACE = 4,
  // Something that cannot happen: time ran backwards.
  PALPATE_FAULT_INTERNAL = 5,
  // The hand was given more energy than a body can give.
  PALPATE_FAULT_ENERGY = 6,
  // The device is not ready any more. Only a host that says so gets it.
  PALPATE_FAULT_NOT_READY = 7,
  // A watchdog took the force away. Only a host with one gets it.
  PALPATE_FAULT_WATCHDOG = 8,
} PalpateFault;

// Interpolation method for the reaction force.
typedef enum PalpateMethod {
  // Eight corners of the cell.
  PALPATE_METHOD_TRILINEAR = 0,
  // 64 points round the cell; smooth.
  PALPATE_METHOD_TRICUBIC = 1,
  // Tri-cubic where it has its points, tri-linear elsewhere.
  PALPATE_METHOD_HYBRID = 2,
  // Radial basis functions r.
  PALPATE_METHOD_RBF_LINEAR = 3,
  // Radial basis functions r^3.
  PALPATE_METHOD_RBF_CUBIC = 4,
  // Cubic Hermite on each force component; smooth.
  PALPATE_METHOD_HERMITE = 5,
  // Gradient of an interpolated energy: smooth and conservative. The most accurate; what to choose.
  PALPATE_METHOD_ENERGY = 6,
  // Gradient of the fitted energy itself: smooth and conservative; the smallest table of few configurations, in f64.
  PALPATE_METHOD_KERNEL = 7,
} PalpateMethod;

// An organ being rendered, in memory of the caller. Only this library looks inside.
typedef struct PalpateController PalpateController;

// An opened blob, in memory of the caller. Only this library looks inside.
typedef struct PalpateOrgan PalpateOrgan;

// How to render. Begin with palpate_config and change what you know better.
typedef struct PalpateConfig {
  // Interpolation method, a PalpateMethod.
  uint32_t method;
  // Buttons that grasp (any of these bits); 0 for never.
  uint32_t grasp_button;
  // Largest distance from the HIP to the node that it may engage, m.
  float capture_radius_m;
  // Tension along the outward normal at which a pushing tool lets go, N.
  float release_tension_n;
  // Height above the first touch at which a pushing tool lets go, m.
  float release_height_m;
  // Coulomb friction of a pushing tool where it may slide; infinite for a tool that sticks to the nearest node.
  float friction;
  // A grasping tool slips off beyond this many times the grid's radius or the largest force.
  float grasp_slip;
  // Largest distance from the surface at which a grasp takes hold, m.
  float grasp_distance_m;
  // Largest force for the hand, N: the device's.
  float max_force_n;
  // Largest change of that force, N/s.
  float max_slew_n_per_s;
  // Time from zero to full force after arming, s.
  float ramp_s;
  // Time in which a force that ends elsewhere than at zero fades, s.
  float fade_s;
  // Largest |x|, |y| and |z| of the HIP, m; beyond it is a fault.
  float max_position_m;
  // Largest speed of the HIP, m/s; beyond it is a fault.
  float max_speed_m_s;
  // Largest stiffness that may be rendered, N/m: the device's, divided by the metres of the model to one of the device. The forces of
  // a stiffer organ are scaled down as a whole.
  float max_stiffness_n_m;
  // Work on the hand in one touch that nobody minds, J.
  float energy_margin_j;
  // Largest virtual damping of the guard on energy, N s/m; 0 for none.
  float energy_damping_n_s_m;
  // Work on the hand that is a fault, J; infinite for never.
  float energy_fault_j;
  // Metres of the model to one of the device.
  float workspace_scale;
  // Step of the positions, m of the model; 0 for none.
  float position_step_m;
  // How long a force is on its way to the motors, us.
  uint32_t force_delay_us;
  // Ticks without a fresh sample that hold the last command; after them the force is zero.
  uint32_t stale_hold_ticks;
  // Age of the newest sample that latches a fault, us.
  uint64_t stale_fault_us;
} PalpateConfig;

// Why a call was refused.
typedef struct PalpateProblem {
  // The status that was returned.
  enum PalpateStatus status;
  // The space it is about, or -1.
  int32_t space;
  // How many there are, or fit.
  uint64_t have;
  // How many are needed.
  uint64_t need;
  // The field or plane it is about, a C string; empty if it is about none.
  char what[PALPATE_WHAT_LEN];
} PalpateProblem;

// One reading of the device.
typedef struct PalpateSample {
  // When it was taken, on the clock of the ticks, us.
  uint64_t t_us;
  // HIP, model frame, m.
  float position_m[3];
  // One bit a button, 1 while pressed.
  uint32_t buttons;
} PalpateSample;

// Result of one tick.
typedef struct PalpateCommand {
  // Force for the hand, model frame, N: finite, and never above the limit.
  float hand_force_n[3];
  // h of the model before any limit, N; zero when free.
  float reaction_n[3];
  // Displacement of the engaged node, m; zero when free.
  float displacement_m[3];
  // The HIP this stands on, m.
  float hip_m[3];
  // The engaged space, or -1.
  int32_t engaged;
  // Data behind the reaction.
  enum PalpateCoverage coverage;
  // What the controller is doing.
  enum PalpatePhase phase;
  // Why it is at zero, if it is after a fault.
  enum PalpateFault fault;
  // Work done on the hand since it touched, J, in device metres: below 0 while it presses.
  float hand_work_j;
  // Whether the reaction was beyond the force limit.
  bool clamped;
  // Whether the guard on energy added damping.
  bool damped;
} PalpateCommand;

// What an organ is.
typedef struct PalpateOrganInfo {
  // Name of the scene, a C string.
  char scene[PALPATE_NAME_LEN];
  // Name of the material law, a C string.
  char law[PALPATE_NAME_LEN];
  // Device force that it was made for, N.
  float max_force_n;
  // Number of spaces (active nodes).
  uint32_t spaces;
  // Vertices of the surface.
  uint32_t vertices;
  // Triangles of the surface.
  uint32_t triangles;
  // Whether the blob says how well it was measured to be; without, do not touch it with a real device.
  bool certified;
} PalpateOrganInfo;

// An active node and the grid of its displacements.
typedef struct PalpateSpaceInfo {
  // Name in the scene, a C string.
  char name[PALPATE_NAME_LEN];
  // Node of the mesh, from 0.
  uint32_t node;
  // Bit m is set if the space has a table for the method of number m.
  uint32_t methods;
  // The node at rest, model frame, m.
  float rest_position_m[3];
  // Unit normal of the surface there, out of the body.
  float outward_normal[3];
  // Distance of neighbouring grid points, m.
  float spacing_m;
  // Radius of the ball of displacements that was solved, m.
  float radius_m;
  // Whether there are displacements for the eye.
  bool displacements;
} PalpateSpaceInfo;

// Reaction force at a displacement of the active node.
typedef struct PalpateForce {
  // h, the force by the tool on the body, N.
  float reaction_n[3];
  // The data behind it.
  enum PalpateCoverage coverage;
} PalpateForce;

// Force with stiffness and energy.
typedef struct PalpateEstimate {
  // h, the force by the tool on the body, N.
  float reaction_n[3];
  // dh_i/dd_j as rows i, N/m.
  float stiffness_n_m[3][3];
  // W, J, where `has_energy`.
  float energy_j;
  // Whether the force is the gradient of an energy here.
  bool has_energy;
  // The data behind it.
  enum PalpateCoverage coverage;
} PalpateEstimate;

// The surface at rest, inside the blob.
typedef struct PalpateSurface {
  // x of every vertex, model frame, m.
  const float *x_m;
  // y of every vertex.
  const float *y_m;
  // z of every vertex.
  const float *z_m;
  // Three vertices a triangle, counter-clockwise seen from outside.
  const uint32_t (*triangles)[3];
  // 1 where a vertex is fixed.
  const uint8_t *fixed;
  // Number of vertices.
  uint32_t vertices;
  // Number of triangles.
  uint32_t triangle_count;
} PalpateSurface;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// A method with the default contact and limits: 8 N, 1 N/ms, half a second of ramp.
enum PalpateStatus palpate_config(uint32_t method_number, struct PalpateConfig *config);

// Bytes that a controller needs.
size_t palpate_controller_size(void);

// Checks a configuration and makes a controller, disarmed. `memory` has at least palpate_controller_size() bytes, aligned to
// PALPATE_ALIGNMENT; it and the organ must stay as long as the controller is used. `problem` may be null.
//
// # Safety
//
// If `memory` is not null, `memory_len` bytes may be written there, and stay as this function leaves them.
enum PalpateStatus palpate_controller_open(uint8_t *memory,
                                           size_t memory_len,
                                           const struct PalpateOrgan *organ,
                                           const struct PalpateConfig *config,
                                           struct PalpateController **controller,
                                           struct PalpateProblem *problem);

// Words of 32 bits that contact with the surface of an organ needs; 0 if the blob has none.
size_t palpate_surface_words(const struct PalpateOrgan *organ);

// From now on the tool touches the organ's surface instead of the planes of its active nodes, and slides where neighbours are active. For the
// start, before palpate_arm: every triangle is looked at. `memory` has at least palpate_surface_words(organ) words and must stay as long as the
// controller is used.
//
// # Safety
//
// If `memory` is not null, `memory_len` words may be written there, and stay as this function leaves them.
enum PalpateStatus palpate_controller_on_surface(struct PalpateController *controller,
                                                 uint32_t *memory,
                                                 size_t memory_len);

// Starts rendering, from zero force. 1 if the controller is active now; after a fault palpate_reset comes first.
bool palpate_arm(struct PalpateController *controller);

// Stops rendering: the next command is zero. A latched fault stays.
void palpate_disarm(struct PalpateController *controller);

// Clears a latched fault. Leaves the controller disarmed.
void palpate_reset(struct PalpateController *controller);

// One tick: what to send to the hand now. `now_us` never runs backwards; `sample` is the newest reading, or null if none came since the
// last tick. Bounded time, no lock, no allocation, no system call. A call that fails commands zero force.
enum PalpateStatus palpate_tick(struct PalpateController *controller,
                                uint64_t now_us,
                                const struct PalpateSample *sample,
                                struct PalpateCommand *command);

// Bytes that an organ needs.
size_t palpate_organ_size(void);

// Checks a blob once, and opens it where it lies. `memory` has at least palpate_organ_size() bytes, aligned to PALPATE_ALIGNMENT; the
// blob starts at an address divisible by 8. Both must stay, and the blob unchanged, as long as the organ is used. `problem` may be
// null. Not for the haptic loop: reads every byte of the blob.
//
// # Safety
//
// Pointers that are not null point to as many bytes as is said with them, which stay as this function leaves them.
enum PalpateStatus palpate_organ_open(uint8_t *memory,
                                      size_t memory_len,
                                      const uint8_t *blob,
                                      size_t blob_len,
                                      const struct PalpateOrgan **organ,
                                      struct PalpateProblem *problem);

// What an organ is.
enum PalpateStatus palpate_organ_info(const struct PalpateOrgan *organ, struct PalpateOrganInfo *info);

// What a space is.
enum PalpateStatus palpate_space_info(const struct PalpateOrgan *organ, uint32_t space, struct PalpateSpaceInfo *info);

// Reaction force of a space at a displacement of its node. Any displacement is answered; a call that fails writes zero.
enum PalpateStatus palpate_force(const struct PalpateOrgan *organ,
                                 uint32_t space,
                                 uint32_t method_number,
                                 const float (*displacement_m)[3],
                                 struct PalpateForce *force);

// Force, stiffness and energy of a space at a displacement of its node. A few times as dear as palpate_force.
enum PalpateStatus palpate_estimate(const struct PalpateOrgan *organ,
                                    uint32_t space,
                                    uint32_t method_number,
                                    const float (*displacement_m)[3],
                                    struct PalpateEstimate *estimate);

// The surface at rest: pointers into the blob.
enum PalpateStatus palpate_surface(const struct PalpateOrgan *organ, struct PalpateSurface *surface);

// Displacement of every vertex of the surface, m, at a displacement of a space's node. For the picture, 30 times a second; `out_m` has
// room for `vertices` points, which are made zero where there is no answer.
//
// # Safety
//
// If `out_m` is not null, `vertices` points may be written there.
enum PalpateStatus palpate_displacements(const struct PalpateOrgan *organ,
                                         uint32_t space,
                                         const float (*displacement_m)[3],
                                         float (*out_m)[3],
                                         size_t vertices);

// One line for a log: what a status means and how to mend it. Never null; not to be freed. Takes any number.
const char *palpate_status_text(int32_t status);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* PALPATE_H */
