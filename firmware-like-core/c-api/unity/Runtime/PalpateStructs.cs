// The structures of palpate.h for C#, with its names and layout, so that they pass to the library without a copy.
// `Tests~` compares each offset and size with the header.
//
// SI units: metres, newtons, joules; times in microseconds. Positions and forces are in the model frame, which
// is right-handed. `reaction_n` is the force by the tool ON the body; `hand_force_n` is that for the hand.
using System;
using System.Runtime.InteropServices;

namespace Palpate
{
    /// <summary>Three components along x, y and z of the model frame.</summary>
    [StructLayout(LayoutKind.Explicit, Size = 12)]
    public struct PalpateVector
    {
        [FieldOffset(0)] public float x;
        [FieldOffset(4)] public float y;
        [FieldOffset(8)] public float z;

        public PalpateVector(float x, float y, float z)
        {
            this.x = x;
            this.y = y;
            this.z = z;
        }
    }

    /// <summary>A matrix as three rows.</summary>
    [StructLayout(LayoutKind.Explicit, Size = 36)]
    public struct PalpateMatrix
    {
        [FieldOffset(0)] public PalpateVector x;
        [FieldOffset(12)] public PalpateVector y;
        [FieldOffset(24)] public PalpateVector z;
    }

    /// <summary>A C bool, because C#'s own is not blittable.</summary>
    [StructLayout(LayoutKind.Explicit, Size = 1)]
    public struct PalpateBool
    {
        [FieldOffset(0)] private byte value;

        public static implicit operator bool(PalpateBool flag)
        {
            return flag.value != 0;
        }
    }

    /// <summary>A C string in 72 bytes. ToString allocates: not for a tick.</summary>
    [StructLayout(LayoutKind.Explicit, Size = 72)]
    public unsafe struct PalpateName
    {
        [FieldOffset(0)] private fixed byte bytes[72];

        public override string ToString()
        {
            fixed (byte* start = bytes)
            {
                return Marshal.PtrToStringAnsi((IntPtr)start);
            }
        }
    }

    /// <summary>A C string in 32 bytes. ToString allocates: not for a tick.</summary>
    [StructLayout(LayoutKind.Explicit, Size = 32)]
    public unsafe struct PalpateWhat
    {
        [FieldOffset(0)] private fixed byte bytes[32];

        public override string ToString()
        {
            fixed (byte* start = bytes)
            {
                return Marshal.PtrToStringAnsi((IntPtr)start);
            }
        }
    }

    /// <summary>
    /// The configuration of a controller. PalpateController.Defaults fills in the defaults; change single fields
    /// afterwards.
    /// </summary>
    [StructLayout(LayoutKind.Explicit, Size = 112)]
    public struct PalpateConfig
    {
        // Interpolation method, a PalpateMethod.
        [FieldOffset(0)] public uint method;
        // Bits of the buttons that start a grasp, any of them; 0 for none.
        [FieldOffset(4)] public uint grasp_button;
        // Largest distance from the HIP to the rest position of a node that it may engage, m.
        [FieldOffset(8)] public float capture_radius_m;
        // Tension along the outward normal at which a pushing tool disengages, N.
        [FieldOffset(12)] public float release_tension_n;
        // Height above the anchor of the contact at which a pushing tool disengages, m.
        [FieldOffset(16)] public float release_height_m;
        // Coefficient of Coulomb friction of a pushing tool that may slide; infinite for a tool that sticks
        // to the nearest node.
        [FieldOffset(20)] public float friction;
        // A grasp is lost beyond this multiple of the radius of the grid or of the largest force.
        [FieldOffset(24)] public float grasp_slip;
        // Largest distance from the surface at which a grasp begins, m.
        [FieldOffset(28)] public float grasp_distance_m;
        // Largest force for the hand, N: the limit of the device.
        [FieldOffset(32)] public float max_force_n;
        // Largest rate of change of that force, N/s.
        [FieldOffset(36)] public float max_slew_n_per_s;
        // Time from zero to the full force after arming, s.
        [FieldOffset(40)] public float ramp_s;
        // Duration of the transition over a jump of the force, s.
        [FieldOffset(44)] public float fade_s;
        // Largest absolute coordinate of the HIP, m; a larger one is a fault.
        [FieldOffset(48)] public float max_position_m;
        // Largest speed of the HIP, m/s; a larger one is a fault.
        [FieldOffset(52)] public float max_speed_m_s;
        // Largest stiffness of the model that may be rendered, N/m: that of the device divided by the metres
        // of the model per metre of the device. The forces of a stiffer organ are all scaled by one factor.
        [FieldOffset(56)] public float max_stiffness_n_m;
        // Work on the hand in one touch that is tolerated, J.
        [FieldOffset(60)] public float energy_margin_j;
        // Largest virtual damping of the passivity control, N s/m; 0 for none.
        [FieldOffset(64)] public float energy_damping_n_s_m;
        // Work on the hand above which a fault is latched, J; infinite for no fault.
        [FieldOffset(68)] public float energy_fault_j;
        // Metres of the model per metre of the device.
        [FieldOffset(72)] public float workspace_scale;
        // Resolution of the positions, metres of the model; 0 if unlimited.
        [FieldOffset(76)] public float position_step_m;
        // Delay from sending a force to its effect at the motors, us.
        [FieldOffset(80)] public uint force_delay_us;
        // Number of ticks without a fresh sample in which the last command is held; then the force is zero.
        [FieldOffset(84)] public uint stale_hold_ticks;
        // Age of the newest sample at which a fault is latched, us.
        [FieldOffset(88)] public ulong stale_fault_us;
        // Force that carries the weight of the handle while active, model frame, N; part of the force for
        // the hand and at most half of its limit.
        [FieldOffset(96)] public PalpateVector gravity_compensation_n;
    }

    /// <summary>Why a call was refused.</summary>
    [StructLayout(LayoutKind.Explicit, Size = 56)]
    public struct PalpateProblem
    {
        // The status that was returned.
        [FieldOffset(0)] public PalpateStatus status;
        // The space concerned, or -1.
        [FieldOffset(4)] public int space;
        // The number found, or the largest number that fits.
        [FieldOffset(8)] public ulong have;
        // The number needed.
        [FieldOffset(16)] public ulong need;
        // Name of the field or plane concerned, a C string; empty if there is none.
        [FieldOffset(24)] public PalpateWhat what;
    }

    /// <summary>One reading of the device.</summary>
    [StructLayout(LayoutKind.Explicit, Size = 24)]
    public struct PalpateSample
    {
        // Time of the reading on the clock of the ticks, us.
        [FieldOffset(0)] public ulong t_us;
        // HIP, model frame, m.
        [FieldOffset(8)] public PalpateVector position_m;
        // One bit per button, 1 while pressed.
        [FieldOffset(20)] public uint buttons;
    }

    /// <summary>Result of one tick.</summary>
    [StructLayout(LayoutKind.Explicit, Size = 72)]
    public struct PalpateCommand
    {
        // Force for the hand, model frame, N: finite, and never above the limit.
        [FieldOffset(0)] public PalpateVector hand_force_n;
        // h of the model before any limit, N; zero without contact.
        [FieldOffset(12)] public PalpateVector reaction_n;
        // Displacement of the engaged node, m; zero without contact.
        [FieldOffset(24)] public PalpateVector displacement_m;
        // The HIP that the command refers to, model frame, m.
        [FieldOffset(36)] public PalpateVector hip_m;
        // Index of the engaged space, or -1 without contact.
        [FieldOffset(48)] public int engaged;
        // The data behind the reaction.
        [FieldOffset(52)] public PalpateCoverage coverage;
        // State of the controller.
        [FieldOffset(56)] public PalpatePhase phase;
        // The latched fault in the phase SAFE_ZERO, otherwise NONE.
        [FieldOffset(60)] public PalpateFault fault;
        // Work on the hand since first touch, joules in metres of the device; negative while it presses.
        [FieldOffset(64)] public float hand_work_j;
        // Whether the reaction exceeded the force limit.
        [FieldOffset(68)] public PalpateBool clamped;
        // Whether the passivity control added damping.
        [FieldOffset(69)] public PalpateBool damped;
    }

    /// <summary>Properties of an organ.</summary>
    [StructLayout(LayoutKind.Explicit, Size = 164)]
    public struct PalpateOrganInfo
    {
        // Name of the scene, a C string.
        [FieldOffset(0)] public PalpateName scene;
        // Name of the material law, a C string.
        [FieldOffset(72)] public PalpateName law;
        // Largest force of the device that the scene was made for, N; infinite without a device.
        [FieldOffset(144)] public float max_force_n;
        // Number of spaces (active nodes).
        [FieldOffset(148)] public uint spaces;
        // Vertices of the surface.
        [FieldOffset(152)] public uint vertices;
        // Triangles of the surface.
        [FieldOffset(156)] public uint triangles;
        // Whether the blob has a certificate of its measured accuracy. Do not render a blob without one on a
        // real device.
        [FieldOffset(160)] public PalpateBool certified;
    }

    /// <summary>An active node and the grid of its displacements.</summary>
    [StructLayout(LayoutKind.Explicit, Size = 116)]
    public struct PalpateSpaceInfo
    {
        // Name in the scene, a C string.
        [FieldOffset(0)] public PalpateName name;
        // Node of the mesh, 0-based.
        [FieldOffset(72)] public uint node;
        // Bit m is set if the space has a table for the method of number m.
        [FieldOffset(76)] public uint methods;
        // Position of the node at rest, model frame, m.
        [FieldOffset(80)] public PalpateVector rest_position_m;
        // Unit outward normal of the surface at the node.
        [FieldOffset(92)] public PalpateVector outward_normal;
        // Distance of neighbouring grid points, m.
        [FieldOffset(104)] public float spacing_m;
        // Radius of the ball of displacements, m.
        [FieldOffset(108)] public float radius_m;
        // Whether the space has surface displacements for pictures.
        [FieldOffset(112)] public PalpateBool displacements;
    }

    /// <summary>Reaction force at a displacement of the active node.</summary>
    [StructLayout(LayoutKind.Explicit, Size = 16)]
    public struct PalpateForce
    {
        // h, the force by the tool on the body, N.
        [FieldOffset(0)] public PalpateVector reaction_n;
        // The data behind the force.
        [FieldOffset(12)] public PalpateCoverage coverage;
    }

    /// <summary>Force with stiffness and energy.</summary>
    [StructLayout(LayoutKind.Explicit, Size = 60)]
    public struct PalpateEstimate
    {
        // h, the force by the tool on the body, N.
        [FieldOffset(0)] public PalpateVector reaction_n;
        // dh_i/dd_j as rows i, N/m.
        [FieldOffset(12)] public PalpateMatrix stiffness_n_m;
        // W, J; valid if `has_energy` is set.
        [FieldOffset(48)] public float energy_j;
        // Whether the force is the gradient of an energy at this displacement.
        [FieldOffset(52)] public PalpateBool has_energy;
        // The data behind the force.
        [FieldOffset(56)] public PalpateCoverage coverage;
    }

    /// <summary>The surface at rest, as pointers into the blob. Pointers of 8 bytes.</summary>
    [StructLayout(LayoutKind.Explicit, Size = 48)]
    public unsafe struct PalpateSurface
    {
        // x of each vertex, model frame, m.
        [FieldOffset(0)] public float* x_m;
        // y of each vertex.
        [FieldOffset(8)] public float* y_m;
        // z of each vertex.
        [FieldOffset(16)] public float* z_m;
        // Three vertices per triangle, counter-clockwise seen from outside.
        [FieldOffset(24)] public uint* triangles;
        // 1 where the vertex is fixed, else 0.
        [FieldOffset(32)] public byte* @fixed;
        // Number of vertices.
        [FieldOffset(40)] public uint vertices;
        // Number of triangles.
        [FieldOffset(44)] public uint triangle_count;
    }
}
