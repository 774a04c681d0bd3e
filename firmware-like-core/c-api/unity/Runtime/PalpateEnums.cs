// The enumerations of palpate.h. `Tests~` compares each name and number with the header.
namespace Palpate
{
    /// <summary>Result of a call. Ok is 0.</summary>
    public enum PalpateStatus
    {
        // Success.
        Ok = 0,
        // A required pointer is null or not aligned for its type.
        NullArgument = 1,
        // The memory for an organ or a controller is null, too small, or not aligned to PALPATE_ALIGNMENT.
        Memory = 2,
        // The organ has no space with this number.
        NoSuchSpace = 3,
        // There is no method with this number.
        NoSuchMethod = 4,
        // The blob has no table for the method: pack it with `--method`.
        MissingMethod = 5,
        // The blob has no surface displacements.
        NoDisplacements = 6,
        // A number of the configuration is not finite or not positive; `what` names it.
        Config = 7,
        // Shorter than any blob.
        TooShort = 8,
        // The blob does not start at an address divisible by 8.
        Misaligned = 9,
        // The first bytes are not those of a blob.
        BadMagic = 10,
        // The blob is shorter than the length it states (`have`, `need`).
        Truncated = 11,
        // The blob is longer than the length it states (`have`, `need`).
        TooLong = 12,
        // The bytes are not those that were written.
        Checksum = 13,
        // The layout version (`need`) is newer than this library supports (`have`).
        NewerVersion = 14,
        // The layout version (`have`) is older than any supported one.
        UnknownVersion = 15,
        // The header cannot be decoded.
        Header = 16,
        // The blob has more of `what` (`need`) than the capacity of this library (`have`).
        Capacity = 17,
        // A number in the header is out of its range; `what` names it.
        Value = 18,
        // The grid of a space is not valid.
        Lattice = 19,
        // A plane of the blob is not valid; `what` names it.
        Plane = 20,
        // The rest point of a space is not solved or not free of force.
        RestPoint = 21,
    }

    /// <summary>The data behind a force.</summary>
    public enum PalpateCoverage
    {
        // No contact and no force.
        None = 0,
        // All eight corners of the cell are solved configurations.
        Cell = 1,
        // All 64 points round the cell are solved configurations.
        SuperCell = 2,
        // A scattered-data method inside its domain.
        Scattered = 3,
        // Data is missing: an unsolved corner, or a position outside the domain. The force is continued
        // without a jump.
        Extrapolated = 4,
    }

    /// <summary>State of the controller.</summary>
    public enum PalpatePhase
    {
        // The force is zero until armed.
        Disarmed = 0,
        // The organ is rendered.
        Active = 1,
        // The force is zero after a fault, until palpate_reset and palpate_arm.
        SafeZero = 2,
    }

    /// <summary>Why the force was set to zero.</summary>
    public enum PalpateFault
    {
        // No fault.
        None = 0,
        // A position was NaN or infinite.
        NotFinite = 1,
        // No fresh sample for too long.
        Stale = 2,
        // The HIP was faster than a hand.
        Overspeed = 3,
        // The HIP left the workspace.
        Workspace = 4,
        // An impossible state, for example a time that ran backwards.
        Internal = 5,
        // The hand got more energy than a passive body can give.
        Energy = 6,
        // The device is no longer homed or ready. Only the host reports this fault, not this library.
        NotReady = 7,
        // A watchdog stopped the force. Only a host with a watchdog reports this fault, not this library.
        Watchdog = 8,
        // The live solver has ended. Only a host with a live solver reports this fault, not this library.
        Solver = 9,
    }

    /// <summary>Interpolation method for the reaction force.</summary>
    public enum PalpateMethod
    {
        // Eight corners of the cell.
        Trilinear = 0,
        // Catmull-Rom on the 64 points round the cell; C1.
        Tricubic = 1,
        // Tri-cubic where all 64 points are solved, tri-linear elsewhere.
        Hybrid = 2,
        // Radial basis functions, phi = r.
        RbfLinear = 3,
        // Radial basis functions, phi = r^3.
        RbfCubic = 4,
        // Cubic Hermite on each force component; C1.
        Hermite = 5,
        // Gradient of the quintic Hermite interpolant of the energy; C1, conservative. The most accurate and
        // recommended method.
        Energy = 6,
        // Gradient of the sum of Gaussians fitted to the energy; smooth, conservative. The smallest table,
        // from few scattered configurations; evaluated in f64.
        Kernel = 7,
    }
}
