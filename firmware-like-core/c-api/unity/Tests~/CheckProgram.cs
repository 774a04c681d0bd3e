// Compares the C# files with the C library: layout, names, forces, errors, ownership, allocations, threads.
//
//     CheckProgram palpate.h REFERENCE PRESSED FILE.blob
//
// REFERENCE is the output of reference.c, PRESSED that of press.c. Prints a PASS line for each check; exits with
// 1 and the first difference otherwise.
using System;
using System.Collections.Generic;
using System.Globalization;
using System.IO;
using System.Linq;
using System.Reflection;
using System.Runtime.InteropServices;
using System.Text.RegularExpressions;
using Palpate;

internal static partial class CheckProgram
{
    private const int Ticks = 100000;
    private const BindingFlags Fields = BindingFlags.Instance | BindingFlags.Public;
    private static volatile object sink;

    private static int Main(string[] args)
    {
        try
        {
            string header = File.ReadAllText(args[0]);
            string[] reference = File.ReadAllLines(args[1]);
            Layout(reference);
            Enumerations(header);
            Functions(header);
            Forces(reference, File.ReadAllLines(args[2]), args[3]);
            Errors(args[3]);
            Ownership(args[3]);
            Allocations(args[3]);
            Touch(args[3]);
            Faults(args[3]);
            return 0;
        }
        catch (Exception exception)
        {
            Console.Error.WriteLine("CheckProgram: " + exception);
            return 1;
        }
    }

    private static void Require(bool holds, string what)
    {
        if (!holds)
        {
            throw new Exception(what);
        }
    }

    private static void Pass(string format, params object[] values)
    {
        Console.WriteLine("PASS " + string.Format(CultureInfo.InvariantCulture, format, values));
    }

    private static Type Named(string name)
    {
        Type type = typeof(PalpateOrgan).Assembly.GetType("Palpate." + name);
        Require(type != null, name + " is missing in C#");
        return type;
    }

    /// <summary>Each field of the header is at the same place in C#, and C# has no others.</summary>
    private static void Layout(string[] reference)
    {
        int structs = 0, fields = 0;
        var seen = new Dictionary<Type, int>();
        foreach (string[] words in reference.Select(line => line.Split(' ')))
        {
            if (words[0] == "struct")
            {
                Type type = Named(words[1]);
                Require(Marshal.SizeOf(type) == int.Parse(words[2]), "size of " + words[1]);
                seen[type] = 0;
                structs++;
            }
            else if (words[0] == "field")
            {
                Type type = Named(words[1]);
                FieldInfo field = type.GetField(words[2], Fields);
                Require(field != null, words[1] + "." + words[2] + " is missing in C#");
                Type of = field.FieldType.IsEnum ? typeof(int) : field.FieldType;
                int size = of.IsPointer ? IntPtr.Size : Marshal.SizeOf(of);
                string name = words[1] + "." + words[2];
                Require((int)Marshal.OffsetOf(type, words[2]) == int.Parse(words[3]), "offset of " + name);
                Require(size == int.Parse(words[4]), "size of " + name);
                seen[type]++;
                fields++;
            }
        }
        foreach (KeyValuePair<Type, int> type in seen)
        {
            Require(type.Key.GetFields(Fields).Length == type.Value, type.Key + " has a field that the header lacks");
        }
        Require(structs == 9 && fields > 70, "the reference is incomplete");
        Pass("layout: {0} structures, {1} fields as in C", structs, fields);
    }

    private static void Enumerations(string header)
    {
        int names = 0;
        foreach (Match type in Regex.Matches(header, @"typedef enum (\w+) \{(.*?)\n\} \w+;", RegexOptions.Singleline))
        {
            Type here = Named(type.Groups[1].Value);
            MatchCollection values = Regex.Matches(type.Groups[2].Value, @"PALPATE_[A-Z]+_(\w+) = (\d+),");
            foreach (Match value in values)
            {
                string name = value.Groups[1].Value.Replace("_", "");
                object parsed = Enum.Parse(here, name, true);
                Require((int)parsed == int.Parse(value.Groups[2].Value), here + "." + name);
                names++;
            }
            Require(Enum.GetNames(here).Length == values.Count, here + " has a name that the header lacks");
        }
        Require(names > 40, "the header was not understood");
        Pass("enumerations: {0} names as in palpate.h", names);
    }

    private static void Functions(string header)
    {
        var declared = new HashSet<string>(
            Regex.Matches(header, @"^[\w ]*[ *](palpate_\w+)\(", RegexOptions.Multiline)
                .Cast<Match>().Select(match => match.Groups[1].Value));
        const BindingFlags Statics = BindingFlags.Static | BindingFlags.NonPublic;
        MethodInfo[] imported = Named("Native").GetMethods(Statics);
        var names = new HashSet<string>(imported.Select(method => method.Name));
        var different = new HashSet<string>(names);
        different.SymmetricExceptWith(declared);
        Require(declared.Count > 15, "the header was not understood");
        Require(different.Count == 0, "in only one of C and C#: " + string.Join(" ", different));
        foreach (MethodInfo method in imported)
        {
            Marshal.Prelink(method);
        }
        Pass("functions: {0} of palpate.h imported and found in the library", names.Count);
    }

    private static byte[] Bytes(string hex)
    {
        return Enumerable.Range(0, hex.Length / 2).Select(i => Convert.ToByte(hex.Substring(2 * i, 2), 16)).ToArray();
    }

    private static unsafe bool Same(void* value, string hex)
    {
        byte[] expected = Bytes(hex);
        return Enumerable.Range(0, expected.Length).All(i => ((byte*)value)[i] == expected[i]);
    }

    private static PalpateController OnPlanes(PalpateOrgan organ)
    {
        PalpateConfig config = PalpateController.Defaults(PalpateMethod.Energy);
        config.max_force_n = Math.Min(config.max_force_n, organ.Info.max_force_n);
        return PalpateController.Open(organ, config, false);
    }

    /// <summary>Every byte of every command is that of C, and the lines of press.c show the same force.</summary>
    private static unsafe void Forces(string[] reference, string[] pressed, string path)
    {
        using (PalpateOrgan organ = PalpateOrgan.Open(path))
        using (PalpateController controller = OnPlanes(organ))
        {
            Require(pressed[0].StartsWith(organ.Info.scene + ", " + organ.Info.law), "the name of the scene");
            PalpateVector normal = organ.Space(0).outward_normal;
            var outward = new List<double>();
            Require(controller.Arm(), "not armed");
            foreach (string[] words in reference.Select(line => line.Split(' ')).Where(line => line[0] == "tick"))
            {
                PalpateSample sample;
                Marshal.Copy(Bytes(words[1]), 0, (IntPtr)(&sample), sizeof(PalpateSample));
                PalpateCommand command;
                Require(controller.Tick(sample.t_us, ref sample, out command) == PalpateStatus.Ok, "a tick was refused");
                Require(Same(&command, words[2]), "the command at " + sample.t_us + " us differs from that in C");
                PalpateVector f = command.hand_force_n;
                outward.Add(f.x * normal.x + f.y * normal.y + f.z * normal.z);
            }
            Require(outward.Count == 1000 && outward.Max() > 0.1, "the organ did not push back");
            int lines = 0;
            foreach (Match line in pressed.Select(text => Regex.Match(text, @"^ *(\d+) ms .* hand +(\S+) N")))
            {
                if (!line.Success)
                {
                    continue;
                }
                double shown = double.Parse(line.Groups[2].Value, CultureInfo.InvariantCulture);
                double here = outward[int.Parse(line.Groups[1].Value)];
                Require(Math.Abs(shown - here) < 0.00051, "press.c: " + line.Value);
                lines++;
            }
            Require(lines == 20, "the output of press.c is incomplete");

            var displacement_m = new PalpateVector(0.001f, -0.002f, 0.003f);
            PalpateEstimate estimate = organ.Estimate(0, PalpateMethod.Energy, displacement_m);
            Require(Same(&estimate, reference.Last().Split(' ')[1]), "the estimate differs from that in C");
            Pass(
                "forces: {0} commands equal those of C in every byte, {1} lines of press.c agree",
                outward.Count,
                lines);
        }
    }

    private static void Errors(string path)
    {
        byte[] blob = File.ReadAllBytes(path);
        try
        {
            PalpateOrgan.Open(blob.Take(1000).ToArray());
            Require(false, "a truncated blob was opened");
        }
        catch (PalpateException refusal)
        {
            Require(refusal.Problem.status == PalpateStatus.Truncated && refusal.Problem.have == 1000, "status");
            Require(refusal.Message.Contains("cut short"), refusal.Message);
            Require(refusal.Message.Contains("need " + blob.Length), refusal.Message);
        }
        using (PalpateOrgan organ = PalpateOrgan.Open(blob))
        {
            PalpateConfig config = PalpateController.Defaults(PalpateMethod.Energy);
            config.max_force_n = float.NaN;
            try
            {
                PalpateController.Open(organ, config, true);
                Require(false, "an invalid configuration was accepted");
            }
            catch (PalpateException refusal)
            {
                Require(refusal.Problem.status == PalpateStatus.Config, refusal.Message);
                Require(refusal.Message.Contains("max_force_n"), refusal.Message);
            }
        }
        Pass("errors: a truncated blob and an invalid configuration give an exception with the reason");
    }

    /// <summary>A controller keeps its organ alive; a use after Dispose is an exception, not a crash.</summary>
    private static void Ownership(string path)
    {
        PalpateOrgan organ = PalpateOrgan.Open(path);
        PalpateController controller = OnPlanes(organ);
        organ.Dispose();
        var command = new PalpateCommand();
        Require(controller.Tick(0, out command) == PalpateStatus.Ok, "a tick after the organ's Dispose");
        controller.Dispose();
        try
        {
            controller.Tick(1000, out command);
            Require(false, "a tick after Dispose");
        }
        catch (ObjectDisposedException)
        {
        }
        for (int i = 0; i < 20; i++)
        {
            OnPlanes(PalpateOrgan.Open(path));
        }
        GC.Collect();
        GC.WaitForPendingFinalizers();
        Pass("ownership: any order of Dispose, and 20 pairs left to the garbage collector");
    }

    /// <summary>100,000 ticks through the organ and back, and the bytes that this thread allocates for them.</summary>
    private static long Allocated(PalpateController controller, PalpateSpaceInfo space, bool planted)
    {
        var sample = new PalpateSample();
        PalpateCommand command;
        PalpateVector rest = space.rest_position_m, normal = space.outward_normal;
        int collections = GC.CollectionCount(0);
        long before = GC.GetAllocatedBytesForCurrentThread();
        for (int tick = 0; tick < Ticks; tick++)
        {
            float along = tick % 1000 * 1e-3f;
            float depth_m = 0.04f * along * (1 - along) - 0.002f;
            sample.t_us = 1000 * (ulong)(tick + 1);
            sample.position_m.x = rest.x - depth_m * normal.x;
            sample.position_m.y = rest.y - depth_m * normal.y;
            sample.position_m.z = rest.z - depth_m * normal.z;
            controller.Tick(sample.t_us, ref sample, out command);
            if (tick % 100 == 50)
            {
                controller.Tick(sample.t_us + 500, out command);
            }
            if (command.phase != PalpatePhase.Active)
            {
                return -1;
            }
            if (planted && tick == Ticks / 2)
            {
                sink = new byte[16];
                GC.KeepAlive(sink);
            }
        }
        long bytes = GC.GetAllocatedBytesForCurrentThread() - before;
        Require(planted || GC.CollectionCount(0) == collections, "a garbage collection ran during the ticks");
        return bytes;
    }

    private static void Allocations(string path)
    {
        using (PalpateOrgan organ = PalpateOrgan.Open(path))
        {
            PalpateSpaceInfo space = organ.Space(0);
            // The first run compiles the code.
            foreach (string run in new[] { "compile", "measure", "planted" })
            {
                using (PalpateController controller = OnPlanes(organ))
                {
                    Require(controller.Arm(), "not armed");
                    var watch = System.Diagnostics.Stopwatch.StartNew();
                    long bytes = Allocated(controller, space, run == "planted");
                    double us = watch.Elapsed.TotalMilliseconds * 1e3;
                    Require(bytes >= 0, "a fault in the ticks");
                    if (run == "measure")
                    {
                        Require(bytes == 0, bytes + " bytes allocated in " + Ticks + " ticks");
                        Pass("allocations: none in {0} ticks, {1:F2} us a tick", Ticks, us / Ticks);
                    }
                    else if (run == "planted")
                    {
                        Require(bytes > 0, "the planted allocation was not found: this check cannot fail");
                    }
                }
            }
        }
    }
}
