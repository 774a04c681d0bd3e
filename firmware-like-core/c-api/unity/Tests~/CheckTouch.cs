// The checks of PalpateTouch: a touch, a silent device, a device that throws.
using System;
using System.IO;
using System.Reflection;
using System.Threading;
using Palpate;
using UnityEngine;

internal static partial class CheckProgram
{
    private static void Send(object target, string message)
    {
        target.GetType().GetMethod(message, BindingFlags.Instance | BindingFlags.NonPublic).Invoke(target, null);
    }

    /// <summary>The example touches the organ for two seconds, with Update at 60 Hz.</summary>
    private static void Touch(string path)
    {
        Application.streamingAssetsPath = Path.GetDirectoryName(path);
        var touch = new PalpateTouch { blobFile = Path.GetFileName(path) };
        touch.handle = new Transform();
        touch.tool = new Transform();
        PalpateSpaceInfo space;
        using (PalpateOrgan organ = PalpateOrgan.Open(path))
        {
            space = organ.Space(0);
        }
        PalpateVector rest = space.rest_position_m, normal = space.outward_normal;
        const float Depth_m = 0.02f;
        touch.handle.position = PalpateTouch.ToUnity(new PalpateVector(
            rest.x - Depth_m * normal.x, rest.y - Depth_m * normal.y, rest.z - Depth_m * normal.z));
        Send(touch, "OnEnable");
        touch.Arm();
        float most_n = 0;
        for (int frame = 0; frame < 120; frame++)
        {
            Thread.Sleep(16);
            Send(touch, "Update");
            PalpateVector f = touch.Last.command.hand_force_n;
            most_n = Math.Max(most_n, f.x * normal.x + f.y * normal.y + f.z * normal.z);
        }
        PalpateTouch.State last = touch.Last;
        Require(touch.enabled && last.command.phase == PalpatePhase.Active, "fault " + last.command.fault);
        Require(most_n > 0.1f && most_n <= touch.maxForceN * 1.001f, "the largest force was " + most_n + " N");
        Send(touch, "OnDisable");
        Require(touch.tool.localPosition.x == PalpateTouch.ToUnity(last.command.hip_m).x, "the tool was not moved");
        Pass(
            "PalpateTouch: {0:F2} N at most; {1} ticks more than 1 ms late, longest gap {2} us",
            most_n,
            last.late,
            last.longest_us);
    }

    /// <summary>A device that rests above the organ, and is silent or throws when the test wants it.</summary>
    private sealed class ScriptedDevice : IPalpateDevice
    {
        internal volatile bool Silent, Throws;
        internal PalpateVector At_m, Last_n;

        public bool Read(ulong now_us, out PalpateVector position_m, out uint buttons)
        {
            position_m = At_m;
            buttons = 0;
            if (Throws)
            {
                throw new IOException("the device was unplugged");
            }
            return !Silent;
        }

        public void Send(PalpateVector force_n)
        {
            Last_n = force_n;
        }
    }

    private static void Until(PalpateTouch touch, Func<bool> holds, string what)
    {
        for (int wait = 0; wait < 400; wait++)
        {
            Send(touch, "Update");
            if (holds())
            {
                return;
            }
            Thread.Sleep(5);
        }
        throw new Exception(what);
    }

    /// <summary>A silent device latches a fault, which the user clears; one that throws ends with zero force.</summary>
    private static void Faults(string path)
    {
        var device = new ScriptedDevice();
        using (PalpateOrgan organ = PalpateOrgan.Open(path))
        {
            PalpateSpaceInfo space = organ.Space(0);
            PalpateVector rest = space.rest_position_m, normal = space.outward_normal;
            device.At_m = new PalpateVector(
                rest.x + 0.01f * normal.x, rest.y + 0.01f * normal.y, rest.z + 0.01f * normal.z);
        }
        var touch = new PalpateTouch { blobFile = Path.GetFileName(path), Device = device };
        Send(touch, "OnEnable");
        touch.Arm();
        Until(touch, () => touch.Last.command.phase == PalpatePhase.Active, "not armed");
        device.Silent = true;
        Until(touch, () => touch.Last.command.fault == PalpateFault.Stale, "no fault for a silent device");
        device.Silent = false;
        touch.Arm();
        Thread.Sleep(50);
        Send(touch, "Update");
        Require(touch.Last.command.phase == PalpatePhase.SafeZero, "a latched fault was lost");
        touch.ResetFault();
        Until(touch, () => touch.Last.command.phase == PalpatePhase.Disarmed, "the fault was not cleared");
        touch.Arm();
        Until(touch, () => touch.Last.command.phase == PalpatePhase.Active, "not armed again");
        device.Last_n = new PalpateVector(1, 1, 1);
        Console.Error.Flush();
        TextWriter errors = Console.Error;
        var logged = new StringWriter();
        Console.SetError(logged);
        device.Throws = true;
        Until(touch, () => !touch.enabled, "an exception of the device was not reported");
        Console.SetError(errors);
        Send(touch, "OnDisable");
        Require(logged.ToString().Contains("unplugged"), "the exception was not logged");
        PalpateVector last = device.Last_n;
        Require(last.x == 0 && last.y == 0 && last.z == 0, "the force was not set to zero at the end");
        Pass("faults: a silent device is a latched fault; one that throws gets zero force and is reported");
    }
}
