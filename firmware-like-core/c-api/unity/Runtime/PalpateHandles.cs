// An organ and a controller with the memory that the library uses.
using System;
using System.IO;
using System.Runtime.InteropServices;

namespace Palpate
{
    /// <summary>
    /// An opened blob. It owns a copy of the bytes, which does not move. Any number of threads may read it.
    /// Dispose releases the memory once no controller uses it.
    /// </summary>
    public sealed class PalpateOrgan : SafeHandle
    {
        private IntPtr block;

        private PalpateOrgan() : base(IntPtr.Zero, true)
        {
        }

        public override bool IsInvalid
        {
            get { return handle == IntPtr.Zero; }
        }

        /// <summary>Opens a file. Throws PalpateException for a blob that the library refuses.</summary>
        public static PalpateOrgan Open(string path)
        {
            return Open(File.ReadAllBytes(path));
        }

        /// <summary>Opens the bytes of a blob, and verifies each. For start-up.</summary>
        public static PalpateOrgan Open(byte[] blob)
        {
            var organ = new PalpateOrgan();
            try
            {
                long size = Memory.RoundUp((long)Native.palpate_organ_size());
                IntPtr memory = Memory.Allocate(size + blob.Length, out organ.block);
                var bytes = new IntPtr(memory.ToInt64() + size);
                Marshal.Copy(blob, 0, bytes, blob.Length);
                IntPtr opened;
                PalpateProblem problem;
                if (Native.palpate_organ_open(memory, (UIntPtr)(ulong)size, bytes, (UIntPtr)(uint)blob.Length,
                    out opened, out problem) != PalpateStatus.Ok)
                {
                    throw new PalpateException(problem);
                }
                organ.SetHandle(opened);
                return organ;
            }
            catch
            {
                // Without a handle the base class would not call ReleaseHandle.
                organ.ReleaseHandle();
                organ.SetHandleAsInvalid();
                throw;
            }
        }

        public PalpateOrganInfo Info
        {
            get
            {
                PalpateOrganInfo info;
                PalpateException.Check(Native.palpate_organ_info(this, out info));
                return info;
            }
        }

        public PalpateSpaceInfo Space(uint space)
        {
            PalpateSpaceInfo info;
            PalpateException.Check(Native.palpate_space_info(this, space, out info));
            return info;
        }

        /// <summary>Force, stiffness and energy at a displacement of the node of a space, m.</summary>
        public PalpateEstimate Estimate(uint space, PalpateMethod method, PalpateVector displacement_m)
        {
            PalpateEstimate estimate;
            PalpateException.Check(
                Native.palpate_estimate(this, space, (uint)method, ref displacement_m, out estimate));
            return estimate;
        }

        /// <summary>Reaction force at a displacement of the node of a space, m. Cheaper than Estimate.</summary>
        public PalpateForce Force(uint space, PalpateMethod method, PalpateVector displacement_m)
        {
            PalpateForce force;
            PalpateException.Check(
                Native.palpate_force(this, space, (uint)method, ref displacement_m, out force));
            return force;
        }

        /// <summary>Vertices at rest, m, and three of them per triangle, counter-clockwise from outside.</summary>
        public unsafe void Surface(out PalpateVector[] rest_m, out int[] triangles)
        {
            PalpateSurface surface;
            PalpateException.Check(Native.palpate_surface(this, out surface));
            rest_m = new PalpateVector[surface.vertices];
            for (int i = 0; i < rest_m.Length; i++)
            {
                rest_m[i] = new PalpateVector(surface.x_m[i], surface.y_m[i], surface.z_m[i]);
            }
            triangles = new int[3 * surface.triangle_count];
            for (int i = 0; i < triangles.Length; i++)
            {
                triangles[i] = (int)surface.triangles[i];
            }
            GC.KeepAlive(this);
        }

        /// <summary>Displacement of each vertex, m, into an array of the caller. Not for a tick.</summary>
        public PalpateStatus Displacements(uint space, PalpateVector displacement_m, PalpateVector[] moved_m)
        {
            return Native.palpate_displacements(
                this, space, ref displacement_m, moved_m, (UIntPtr)(uint)moved_m.Length);
        }

        protected override bool ReleaseHandle()
        {
            Memory.Free(ref block);
            return true;
        }
    }

    /// <summary>
    /// A controller. It belongs to one thread at a time: all methods except Dispose are for the haptic thread, or
    /// for any other thread before that one has started or after it has ended. It keeps its organ alive.
    /// </summary>
    public sealed class PalpateController : SafeHandle
    {
        private IntPtr block;
        private IntPtr surfaceBlock;
        private PalpateOrgan organ;

        private PalpateController() : base(IntPtr.Zero, true)
        {
        }

        public override bool IsInvalid
        {
            get { return handle == IntPtr.Zero; }
        }

        /// <summary>The default configuration of a method.</summary>
        public static PalpateConfig Defaults(PalpateMethod method)
        {
            PalpateConfig config;
            PalpateException.Check(Native.palpate_config((uint)method, out config));
            return config;
        }

        /// <summary>
        /// Creates a disarmed controller. With `onSurface` the tool slides over the triangles of the organ, if it
        /// has any; otherwise it touches the plane of the nearest active node.
        /// </summary>
        public static PalpateController Open(PalpateOrgan organ, PalpateConfig config, bool onSurface)
        {
            var controller = new PalpateController();
            try
            {
                bool added = false;
                organ.DangerousAddRef(ref added);
                controller.organ = organ;
                UIntPtr size = Native.palpate_controller_size();
                IntPtr memory = Memory.Allocate((long)size, out controller.block);
                IntPtr opened;
                PalpateProblem problem;
                if (Native.palpate_controller_open(memory, size, organ, ref config, out opened, out problem)
                    != PalpateStatus.Ok)
                {
                    throw new PalpateException(problem);
                }
                controller.SetHandle(opened);
                UIntPtr words = Native.palpate_surface_words(organ);
                if (onSurface && words != UIntPtr.Zero)
                {
                    IntPtr surface = Memory.Allocate(4 * (long)words, out controller.surfaceBlock);
                    PalpateException.Check(Native.palpate_controller_on_surface(controller, surface, words));
                }
                return controller;
            }
            catch
            {
                controller.ReleaseHandle();
                controller.SetHandleAsInvalid();
                throw;
            }
        }

        /// <summary>Starts rendering from zero force. Returns whether the controller is active.</summary>
        public bool Arm()
        {
            return Native.palpate_arm(this);
        }

        /// <summary>Stops rendering: the next command is zero.</summary>
        public void Disarm()
        {
            Native.palpate_disarm(this);
        }

        /// <summary>Clears a latched fault and leaves the controller disarmed.</summary>
        public void Reset()
        {
            Native.palpate_reset(this);
        }

        /// <summary>
        /// One tick with a fresh sample. Allocates nothing and throws nothing for a refusal, which has zero force.
        /// </summary>
        public PalpateStatus Tick(ulong now_us, ref PalpateSample sample, out PalpateCommand command)
        {
            return Native.palpate_tick(this, now_us, ref sample, out command);
        }

        /// <summary>One tick without a fresh sample.</summary>
        public PalpateStatus Tick(ulong now_us, out PalpateCommand command)
        {
            return Native.palpate_tick(this, now_us, IntPtr.Zero, out command);
        }

        protected override bool ReleaseHandle()
        {
            Memory.Free(ref block);
            Memory.Free(ref surfaceBlock);
            if (organ != null)
            {
                organ.DangerousRelease();
                organ = null;
            }
            return true;
        }
    }

    /// <summary>Memory outside the managed heap, which the garbage collector does not move.</summary>
    internal static class Memory
    {
        internal static long RoundUp(long bytes)
        {
            return (bytes + Native.Alignment - 1) / Native.Alignment * Native.Alignment;
        }

        /// <summary>An aligned address in a new block; `block` is what Free needs.</summary>
        internal static IntPtr Allocate(long bytes, out IntPtr block)
        {
            block = Marshal.AllocHGlobal(new IntPtr(bytes + Native.Alignment));
            return new IntPtr(RoundUp(block.ToInt64()));
        }

        internal static void Free(ref IntPtr block)
        {
            if (block != IntPtr.Zero)
            {
                Marshal.FreeHGlobal(block);
                block = IntPtr.Zero;
            }
        }
    }
}
