// The functions of palpate.h. PalpateOrgan and PalpateController use them and own the memory.
using System;
using System.Runtime.InteropServices;

namespace Palpate
{
    /// <summary>
    /// P/Invoke of each function of palpate.h. A handle in an argument keeps its memory alive until the call has
    /// returned.
    /// </summary>
    internal static class Native
    {
        // libpalpate_c.so, palpate_c.dll or libpalpate_c.dylib.
        private const string Library = "palpate_c";
        internal const int Alignment = 16;

        [DllImport(Library)]
        internal static extern PalpateStatus palpate_config(uint method_number, out PalpateConfig config);

        [DllImport(Library)]
        internal static extern UIntPtr palpate_controller_size();

        [DllImport(Library)]
        internal static extern PalpateStatus palpate_controller_open(
            IntPtr memory, UIntPtr memory_len, PalpateOrgan organ, ref PalpateConfig config,
            out IntPtr controller, out PalpateProblem problem);

        [DllImport(Library)]
        internal static extern UIntPtr palpate_surface_words(PalpateOrgan organ);

        [DllImport(Library)]
        internal static extern PalpateStatus palpate_controller_on_surface(
            PalpateController controller, IntPtr memory, UIntPtr memory_len);

        [DllImport(Library)]
        [return: MarshalAs(UnmanagedType.I1)]
        internal static extern bool palpate_arm(PalpateController controller);

        [DllImport(Library)]
        internal static extern void palpate_disarm(PalpateController controller);

        [DllImport(Library)]
        internal static extern void palpate_reset(PalpateController controller);

        [DllImport(Library)]
        internal static extern PalpateStatus palpate_tick(
            PalpateController controller, ulong now_us, ref PalpateSample sample, out PalpateCommand command);

        // A tick without a fresh sample: `sample` is zero.
        [DllImport(Library)]
        internal static extern PalpateStatus palpate_tick(
            PalpateController controller, ulong now_us, IntPtr sample, out PalpateCommand command);

        [DllImport(Library)]
        internal static extern UIntPtr palpate_organ_size();

        [DllImport(Library)]
        internal static extern PalpateStatus palpate_organ_open(
            IntPtr memory, UIntPtr memory_len, IntPtr blob, UIntPtr blob_len, out IntPtr organ,
            out PalpateProblem problem);

        [DllImport(Library)]
        internal static extern PalpateStatus palpate_organ_info(PalpateOrgan organ, out PalpateOrganInfo info);

        [DllImport(Library)]
        internal static extern PalpateStatus palpate_space_info(
            PalpateOrgan organ, uint space, out PalpateSpaceInfo info);

        [DllImport(Library)]
        internal static extern PalpateStatus palpate_force(
            PalpateOrgan organ, uint space, uint method_number, ref PalpateVector displacement_m,
            out PalpateForce force);

        [DllImport(Library)]
        internal static extern PalpateStatus palpate_estimate(
            PalpateOrgan organ, uint space, uint method_number, ref PalpateVector displacement_m,
            out PalpateEstimate estimate);

        [DllImport(Library)]
        internal static extern PalpateStatus palpate_surface(PalpateOrgan organ, out PalpateSurface surface);

        [DllImport(Library)]
        internal static extern PalpateStatus palpate_displacements(
            PalpateOrgan organ, uint space, ref PalpateVector displacement_m, [Out] PalpateVector[] out_m,
            UIntPtr vertices);

        [DllImport(Library)]
        internal static extern IntPtr palpate_status_text(int status);
    }

    /// <summary>A call was refused. The message has the reason and the fix.</summary>
    public sealed class PalpateException : Exception
    {
        public readonly PalpateProblem Problem;

        internal PalpateException(PalpateProblem problem) : base(Text(problem))
        {
            Problem = problem;
        }

        /// <summary>Throws if a call failed that reports no details.</summary>
        internal static void Check(PalpateStatus status)
        {
            if (status != PalpateStatus.Ok)
            {
                throw new PalpateException(new PalpateProblem { status = status, space = -1 });
            }
        }

        private static string Text(PalpateProblem problem)
        {
            string text = Marshal.PtrToStringAnsi(Native.palpate_status_text((int)problem.status));
            string what = problem.what.ToString();
            string space = problem.space < 0 ? "" : ", space " + problem.space;
            string numbers = problem.have == 0 && problem.need == 0
                ? ""
                : " (have " + problem.have + ", need " + problem.need + ")";
            return text + (what.Length == 0 ? "" : ": " + what) + space + numbers;
        }
    }
}
