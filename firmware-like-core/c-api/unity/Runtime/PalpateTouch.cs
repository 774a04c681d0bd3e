// An example: an organ in a scene, touched by a simulated hand or by a device that the project supplies.
//
// Three rules for the threads, explained in README.md:
// - The haptic thread owns the controller and the device. Only it calls Tick, Arm, Disarm and Reset.
// - The main thread reads the latest state and the organ, and passes requests.
// - A managed thread stops during a garbage collection. With a real device use a native haptic thread.
using System;
using System.Diagnostics;
using System.IO;
using System.Threading;
using UnityEngine;

namespace Palpate
{
    [RequireComponent(typeof(MeshFilter))]
    public sealed class PalpateTouch : MonoBehaviour
    {
        /// <summary>State after the last tick.</summary>
        public struct State
        {
            public PalpateCommand command;
            /// <summary>Ticks more than 1 ms late: collections of garbage and other threads.</summary>
            public uint late;
            /// <summary>Longest time between two ticks, us.</summary>
            public uint longest_us;
        }

        [Tooltip("A .blob in StreamingAssets")]
        public string blobFile = "organ.blob";
        [Tooltip("Object that the user moves; the simulated hand follows it")]
        public Transform handle;
        [Tooltip("Child of this object, shown at the haptic interface point")]
        public Transform tool;
        [Tooltip("Limit of the device, N; begin at 1 N")]
        public float maxForceN = 1f;
        [Tooltip("Stiffness that the device renders stably, N/m")]
        public float maxStiffnessNPerM = 500f;

        /// <summary>Set before the component is enabled; a simulated hand if null.</summary>
        public IPalpateDevice Device;
        /// <summary>Main thread: the state that Update has read last.</summary>
        public State Last;

        private const ulong Period_us = 1000;
        private const int None = 0, ToArm = 1, ToDisarm = 2, ToReset = 3;
        private PalpateOrgan organ;
        private PalpateController controller;
        private PalpateSimulatedHand hand;
        private IPalpateDevice device;
        private Thread thread;
        private PalpateLatest<State> latest;
        private volatile bool stopping;
        private volatile Exception failure;
        private int request;
        private Mesh mesh;
        private PalpateVector[] rest_m, moved_m;
        private Vector3[] vertices;

        /// <summary>Any thread. The force then rises over `ramp_s`. Let the user ask for it.</summary>
        public void Arm()
        {
            Interlocked.Exchange(ref request, ToArm);
        }

        public void Disarm()
        {
            Interlocked.Exchange(ref request, ToDisarm);
        }

        /// <summary>After a fault, before Arm.</summary>
        public void ResetFault()
        {
            Interlocked.Exchange(ref request, ToReset);
        }

        /// <summary>Unity's frame is left-handed: x changes its sign.</summary>
        public static Vector3 ToUnity(PalpateVector model)
        {
            return new Vector3(-model.x, model.y, model.z);
        }

        public static PalpateVector ToModel(Vector3 unity)
        {
            return new PalpateVector(-unity.x, unity.y, unity.z);
        }

        private void OnEnable()
        {
            organ = PalpateOrgan.Open(Path.Combine(Application.streamingAssetsPath, blobFile));
            if (Device != null && !organ.Info.certified)
            {
                organ.Dispose();
                throw new InvalidOperationException(blobFile + " has no certificate: pack it with palpate pack");
            }
            PalpateSpaceInfo space = organ.Space(0);
            PalpateConfig config = PalpateController.Defaults(PalpateMethod.Energy);
            config.max_force_n = Math.Min(maxForceN, organ.Info.max_force_n);
            config.max_stiffness_n_m = maxStiffnessNPerM;
            try
            {
                controller = PalpateController.Open(organ, config, true);
            }
            catch
            {
                organ.Dispose();
                throw;
            }
            hand = new PalpateSimulatedHand(Above(space, 0.02f));
            device = Device ?? hand;
            BuildMesh();

            latest = new PalpateLatest<State>();
            failure = null;
            stopping = false;
            request = None;
            thread = new Thread(Run) { Name = "palpate", IsBackground = true };
            thread.Priority = System.Threading.ThreadPriority.Highest;
            thread.Start();
        }

        // Also called before the editor reloads scripts: the thread must not outlive its code.
        private void OnDisable()
        {
            stopping = true;
            if (thread != null)
            {
                thread.Join();
                thread = null;
            }
            if (controller != null)
            {
                controller.Dispose();
                organ.Dispose();
                controller = null;
            }
        }

        private void Update()
        {
            if (failure != null)
            {
                UnityEngine.Debug.LogException(failure);
                enabled = false;
                return;
            }
            latest.TryRead(ref Last);
            if (handle != null)
            {
                PalpateVector target_m = ToModel(transform.InverseTransformPoint(handle.position));
                hand.Target_m.Write(ref target_m);
            }
            if (tool != null)
            {
                tool.localPosition = ToUnity(Last.command.hip_m);
            }
            Draw();
        }

        private static PalpateVector Above(PalpateSpaceInfo space, float height_m)
        {
            PalpateVector at = space.rest_position_m, normal = space.outward_normal;
            return new PalpateVector(
                at.x + height_m * normal.x, at.y + height_m * normal.y, at.z + height_m * normal.z);
        }

        private void BuildMesh()
        {
            int[] triangles;
            organ.Surface(out rest_m, out triangles);
            moved_m = new PalpateVector[rest_m.Length];
            vertices = new Vector3[rest_m.Length];
            // Unity's front faces are clockwise.
            for (int i = 0; i < triangles.Length; i += 3)
            {
                int second = triangles[i + 1];
                triangles[i + 1] = triangles[i + 2];
                triangles[i + 2] = second;
            }
            mesh = new Mesh { indexFormat = UnityEngine.Rendering.IndexFormat.UInt32 };
            mesh.MarkDynamic();
            Draw();
            mesh.triangles = triangles;
            GetComponent<MeshFilter>().mesh = mesh;
        }

        private void Draw()
        {
            PalpateCommand command = Last.command;
            bool moves = thread != null && command.engaged >= 0
                && organ.Displacements((uint)command.engaged, command.displacement_m, moved_m) == PalpateStatus.Ok;
            for (int i = 0; i < vertices.Length; i++)
            {
                vertices[i] = ToUnity(rest_m[i]);
                if (moves)
                {
                    vertices[i] += ToUnity(moved_m[i]);
                }
            }
            mesh.vertices = vertices;
            mesh.RecalculateNormals();
        }

        // The haptic thread: nothing here allocates, locks or touches an object of Unity.
        private void Run()
        {
            try
            {
                Loop();
            }
            catch (Exception exception)
            {
                failure = exception;
            }
            finally
            {
                device.Send(new PalpateVector());
            }
        }

        private void Loop()
        {
            long start = Stopwatch.GetTimestamp();
            double us_per_count = 1e6 / Stopwatch.Frequency;
            var state = new State();
            var sample = new PalpateSample();
            ulong due_us = 0, last_us = 0;
            while (!stopping)
            {
                var now_us = (ulong)((Stopwatch.GetTimestamp() - start) * us_per_count);
                // A busy wait, because the shortest sleep takes 1 to 16 ms. It needs a core of its own.
                if (now_us < due_us)
                {
                    Thread.Yield();
                    continue;
                }
                state.late += now_us > due_us + Period_us ? 1u : 0u;
                state.longest_us = Math.Max(state.longest_us, (uint)(now_us - last_us));
                last_us = now_us;
                // Missed ticks are left out.
                due_us = now_us > due_us + Period_us ? now_us + Period_us : due_us + Period_us;

                Follow(Interlocked.Exchange(ref request, None));
                sample.t_us = now_us;
                if (device.Read(now_us, out sample.position_m, out sample.buttons))
                {
                    controller.Tick(now_us, ref sample, out state.command);
                }
                else
                {
                    controller.Tick(now_us, out state.command);
                }
                device.Send(state.command.hand_force_n);
                latest.Write(ref state);
            }
        }

        private void Follow(int wanted)
        {
            switch (wanted)
            {
                case ToArm: controller.Arm(); break;
                case ToDisarm: controller.Disarm(); break;
                case ToReset: controller.Reset(); break;
            }
        }
    }
}
