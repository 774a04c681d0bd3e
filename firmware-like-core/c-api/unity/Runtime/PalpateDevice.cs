// A device as the haptic thread sees it, a simulated hand, and the exchange between two threads.
using System.Threading;

namespace Palpate
{
    /// <summary>A haptic device. Only the haptic thread calls it; no method may allocate or block.</summary>
    public interface IPalpateDevice
    {
        /// <summary>HIP in the model frame, m. Returns false without a fresh reading.</summary>
        bool Read(ulong now_us, out PalpateVector position_m, out uint buttons);

        /// <summary>Force for the hand in the model frame, N.</summary>
        void Send(PalpateVector force_n);
    }

    /// <summary>
    /// The latest value from one thread for others, without a lock: the writer never waits. T is a structure
    /// without references. A version that is odd marks a write in progress.
    /// </summary>
    public sealed class PalpateLatest<T> where T : struct
    {
        private const int Attempts = 8;
        private T value;
        private int version;

        /// <summary>For one thread only.</summary>
        public void Write(ref T latest)
        {
            Interlocked.Increment(ref version);
            value = latest;
            Interlocked.Increment(ref version);
        }

        /// <summary>Leaves `into` as it is and returns false if the writer was active at each attempt.</summary>
        public bool TryRead(ref T into)
        {
            for (int attempt = 0; attempt < Attempts; attempt++)
            {
                int before = Volatile.Read(ref version);
                T copy = value;
                Thread.MemoryBarrier();
                if (before % 2 == 0 && Volatile.Read(ref version) == before)
                {
                    into = copy;
                    return true;
                }
            }
            return false;
        }
    }

    /// <summary>
    /// A simulated hand of 0.2 kg with a spring to a target and a damper, for work without a device. Another
    /// thread writes the target.
    /// </summary>
    public sealed class PalpateSimulatedHand : IPalpateDevice
    {
        public readonly PalpateLatest<PalpateVector> Target_m = new PalpateLatest<PalpateVector>();
        private const float Mass_kg = 0.2f, Spring_n_m = 150f, Damper_n_s_m = 12f, MaxStep_s = 2e-3f;
        private PalpateVector position_m, velocity_m_s, force_n, target_m;
        private ulong last_us;

        public PalpateSimulatedHand(PalpateVector start_m)
        {
            position_m = start_m;
            Target_m.Write(ref start_m);
        }

        public bool Read(ulong now_us, out PalpateVector at_m, out uint buttons)
        {
            float step_s = System.Math.Min((now_us - last_us) * 1e-6f, MaxStep_s);
            last_us = now_us;
            Target_m.TryRead(ref target_m);
            Move(ref position_m.x, ref velocity_m_s.x, force_n.x, target_m.x, step_s);
            Move(ref position_m.y, ref velocity_m_s.y, force_n.y, target_m.y, step_s);
            Move(ref position_m.z, ref velocity_m_s.z, force_n.z, target_m.z, step_s);
            at_m = position_m;
            buttons = 0;
            return true;
        }

        public void Send(PalpateVector latest_n)
        {
            force_n = latest_n;
        }

        private static void Move(ref float at_m, ref float speed_m_s, float hand_n, float goal_m, float step_s)
        {
            float sum_n = hand_n + Spring_n_m * (goal_m - at_m) - Damper_n_s_m * speed_m_s;
            speed_m_s += step_s / Mass_kg * sum_n;
            at_m += step_s * speed_m_s;
        }
    }
}
