//! The doctor on simulated PCs: a good one, a bad one, an empty one.

use super::*;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

const PRIORITY: i32 = 50;

/// A folder with the files of a PC.
struct Pc(tempfile::TempDir);

impl Pc {
    fn new(files: &[(&str, &str)]) -> Self {
        let pc = Self(tempfile::tempdir().expect("a temporary directory"));
        files.iter().for_each(|(path, text)| pc.write(path, text));
        pc
    }

    fn path(&self, path: &str) -> std::path::PathBuf {
        self.0.path().join(path.trim_start_matches('/'))
    }

    fn write(&self, path: &str, text: &str) {
        let path = self.path(path);
        std::fs::create_dir_all(path.parent().expect("in a folder")).expect("made");
        std::fs::write(&path, text).expect("written");
        self.mode(&path, 0o666);
    }

    fn mode(&self, path: &Path, mode: u32) {
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).expect("changed");
    }

    fn probe(&self) -> Probe {
        Probe::with_root(self.0.path().into(), Some(1))
    }

    fn checks(&self) -> Vec<Check> {
        examine(&self.probe(), loop_cpu(&self.probe(), None), PRIORITY)
    }
}

/// The check with that name.
fn named<'c>(checks: &'c [Check], name: &str) -> &'c Check {
    checks.iter().find(|check| check.name == name).unwrap_or_else(|| panic!("no check {name}"))
}

fn limits(priority: &str, memory: &str) -> String {
    format!(
        "Limit                     Soft Limit           Hard Limit           Units     \n\
         Max locked memory         {memory:<20} {memory:<20} bytes     \n\
         Max realtime priority     {priority:<20} {priority:<20} \n"
    )
}

/// A user with few rights who does not own these files.
const STATUS: &str = "Name:\tpalpate\nUid:\t4242\t4242\t4242\t4242\nGid:\t4242\t4242\t4242\t4242\n\
                      Groups:\t4242 4243 \nCapEff:\t0000000000000000\nCpus_allowed_list:\t0-3\n";

/// Four CPUs and a real-time kernel; CPU 3 is isolated.
fn good() -> Pc {
    let limits = limits("95", "unlimited");
    let pc = Pc::new(&[
        (
            "/proc/version",
            "Linux version 6.1.0-44-rt-amd64 (debian) #1 SMP PREEMPT_RT Debian 6.1.1 (2026-01-01)",
        ),
        ("/sys/kernel/realtime", "1\n"),
        ("/proc/self/limits", &limits),
        ("/proc/self/status", STATUS),
        ("/proc/cpuinfo", "processor : 0\nflags\t\t: fpu tsc sse2\n"),
        ("/proc/cmdline", "quiet isolcpus=domain,managed_irq,3 nohz_full=3 rcu_nocbs=3 irqaffinity=0-2"),
        ("/proc/irq/9/effective_affinity_list", "0\n"),
        ("/proc/irq/default_smp_affinity", "7\n"),
        ("/proc/1/comm", "systemd\n"),
        ("/proc/sys/kernel/sched_rt_runtime_us", "950000\n"),
        ("/proc/sys/kernel/sched_rt_period_us", "1000000\n"),
        ("/proc/swaps", "Filename\tType\tSize\tUsed\tPriority\n"),
        ("/proc/loadavg", "0.10 0.20 0.30 1/200 1234\n"),
        ("/dev/cpu_dma_latency", ""),
        ("/sys/devices/system/clocksource/clocksource0/current_clocksource", "tsc\n"),
        ("/sys/devices/system/cpu/online", "0-3\n"),
        ("/sys/devices/system/cpu/isolated", "3\n"),
        ("/sys/bus/usb/devices/1-1/idVendor", "0403\n"),
        ("/sys/bus/usb/devices/1-1/idProduct", "cb48\n"),
        ("/sys/bus/usb/devices/1-1/busnum", "1\n"),
        ("/sys/bus/usb/devices/1-1/devnum", "7\n"),
        ("/sys/bus/usb/devices/1-1/power/control", "on\n"),
        ("/dev/bus/usb/001/007", ""),
        ("/sys/class/tty/ttyUSB0/uevent", ""),
        ("/dev/ttyUSB0", ""),
        ("/sys/bus/usb-serial/devices/ttyUSB0/latency_timer", "1\n"),
    ]);
    for cpu in 0..4 {
        let file = |name: &str| format!("/sys/devices/system/cpu/cpu{cpu}/{name}");
        pc.write(&file("cpufreq/scaling_governor"), "performance\n");
        pc.write(&file("topology/thread_siblings_list"), &format!("{cpu}\n"));
        pc.write(&file("cpuidle/state0/latency"), "0\n");
        pc.write(&file("cpuidle/state0/name"), "POLL\n");
        pc.write(&file("cpuidle/state0/disable"), "0\n");
        pc.write(&file("cpuidle/state1/latency"), "133\n");
        pc.write(&file("cpuidle/state1/name"), "C6\n");
        pc.write(&file("cpuidle/state1/disable"), "0\n");
    }
    pc
}

#[test]
fn a_good_pc_has_nothing_to_fix() {
    let checks = good().checks();
    assert_eq!(checks.len(), 15);
    for check in &checks {
        assert_eq!((check.verdict, check.fix.len()), (Verdict::Good, 0), "{check}");
    }
}

/// File, contents, affected check, its verdict, and a part of its fix.
type Defect = (&'static str, &'static str, &'static str, Verdict, &'static str);

/// Each defect alone on the good PC affects only its own check.
#[test]
fn each_defect_is_found_by_its_own_check() {
    let ordinary = "Linux version 6.1.0-44-amd64 (debian) #1 SMP PREEMPT_DYNAMIC Debian 6.1.1";
    let voluntary = "Linux version 6.1.0-44-amd64 (debian) #1 SMP Debian 6.1.1";
    let ills: [Defect; 17] = [
        ("/proc/version", ordinary, "kernel", Verdict::Better, "linux-image-rt-"),
        ("/proc/version", voluntary, "kernel", Verdict::Bad, "linux-image-rt-"),
        ("/proc/self/limits", "rtprio", "priority", Verdict::Bad, "palpate-limits.conf"),
        ("/proc/self/limits", "memlock", "memory", Verdict::Better, "palpate-limits.conf"),
        ("/proc/cpuinfo", "flags\t: fpu hypervisor sse2", "machine", Verdict::Better, "bare"),
        (
            "/sys/devices/system/cpu/cpu3/cpufreq/scaling_governor",
            "powersave",
            "governor",
            Verdict::Better,
            "cpupower",
        ),
        (
            "/proc/cmdline",
            "quiet isolcpus=domain,managed_irq,3 nohz_full=3",
            "isolation",
            Verdict::Better,
            "rcu_nocbs=3",
        ),
        ("/proc/cmdline", "quiet", "isolation", Verdict::Better, "irqaffinity=0-2"),
        ("/proc/irq/9/effective_affinity_list", "3", "interrupts", Verdict::Better, "smp_affinity_list"),
        ("/proc/77/comm", "irqbalance", "interrupts", Verdict::Better, "IRQBALANCE_BANNED_CPULIST=3"),
        (
            "/sys/devices/system/cpu/cpu3/topology/thread_siblings_list",
            "1,3",
            "hyperthreads",
            Verdict::Better,
            "cpu1/online",
        ),
        (
            "/sys/devices/system/clocksource/clocksource0/current_clocksource",
            "hpet",
            "timers",
            Verdict::Better,
            "dmesg",
        ),
        ("/proc/sys/kernel/sched_rt_runtime_us", "50000", "throttling", Verdict::Bad, "sysctl"),
        ("/proc/loadavg", "3.9 0 0 1/2 3", "load", Verdict::Better, "top"),
        ("/sys/bus/usb/devices/1-1/power/control", "auto", "usb", Verdict::Better, "70-palpate.rules"),
        ("/sys/bus/usb-serial/devices/ttyUSB0/latency_timer", "16", "serial", Verdict::Bad, "latency_timer"),
        ("/sys/devices/system/cpu/online", "3", "isolation", Verdict::Bad, "two"),
    ];
    for (path, text, name, verdict, fix) in ills {
        let pc = good();
        match text {
            "rtprio" => pc.write(path, &limits("0", "unlimited")),
            "memlock" => pc.write(path, &limits("95", "8388608")),
            text => pc.write(path, text),
        }
        if path == "/proc/version" {
            std::fs::remove_file(pc.path("/sys/kernel/realtime")).expect("it was there");
        }
        let checks = pc.checks();
        let defect = named(&checks, name);
        assert_eq!(defect.verdict, verdict, "{path} = {text}: {defect}");
        assert!(defect.fix.iter().any(|line| line.contains(fix)), "{fix} in {defect}");
        let others: Vec<&Check> =
            checks.iter().filter(|check| check.name != name && check.verdict != Verdict::Good).collect();
        assert!(others.is_empty(), "{path} = {text} makes {others:?}");
    }
}

/// Older kernels do not list isolated CPUs. The command line has flags before its list.
#[test]
fn isolation_is_read_from_the_command_line_too() {
    let pc = good();
    std::fs::remove_file(pc.path("/sys/devices/system/cpu/isolated")).expect("it was there");
    assert_eq!(named(&pc.checks(), "isolation").verdict, Verdict::Good);
    pc.write("/proc/cmdline", "quiet isolcpus=domain,managed_irq,2 nohz_full=3 rcu_nocbs=all");
    let checks = pc.checks();
    let found = &named(&checks, "isolation").found;
    assert!(found.contains("isolcpus") && !found.contains("rcu_nocbs"), "{found}");
}

#[test]
fn a_node_without_permission_is_reported() {
    for (path, name, verdict, fix) in [
        ("/dev/cpu_dma_latency", "idle", Verdict::Better, "udev"),
        ("/dev/bus/usb/001/007", "usb", Verdict::Bad, "70-palpate.rules"),
        ("/dev/ttyUSB0", "serial", Verdict::Bad, "dialout"),
    ] {
        let pc = good();
        pc.mode(&pc.path(path), 0o660);
        let checks = pc.checks();
        assert_eq!(named(&checks, name).verdict, verdict, "{path}");
        assert!(named(&checks, name).fix.iter().any(|line| line.contains(fix)), "{}", named(&checks, name));
        // The owner's group has permission, and this user is in it.
        use std::os::unix::fs::MetadataExt;
        let group = pc.path(path).metadata().expect("there").gid();
        pc.write("/proc/self/status", &STATUS.replace("4243", &group.to_string()));
        assert_eq!(named(&pc.checks(), name).verdict, Verdict::Good, "{path}");
    }
}

#[test]
fn capabilities_replace_limits() {
    let pc = good();
    pc.write("/proc/self/limits", &limits("0", "65536"));
    assert_eq!(named(&pc.checks(), "priority").verdict, Verdict::Bad);
    // CAP_SYS_NICE and CAP_IPC_LOCK.
    pc.write("/proc/self/status", &STATUS.replace("CapEff:\t0000000000000000", "CapEff:\t0000000000804000"));
    for name in ["priority", "memory", "swap"] {
        assert_eq!(named(&pc.checks(), name).verdict, Verdict::Good);
    }
    // The guard needs one more than the loop.
    pc.write("/proc/self/status", STATUS);
    for (limit, verdict) in [("50", Verdict::Bad), ("51", Verdict::Good)] {
        pc.write("/proc/self/limits", &limits(limit, "unlimited"));
        assert_eq!(named(&pc.checks(), "priority").verdict, verdict);
    }
}

#[test]
fn swap_matters_only_if_memory_cannot_be_locked() {
    let pc = good();
    pc.write("/proc/swaps", "Filename\tType\n/dev/sda2 partition 1 0 -2\n");
    assert_eq!(named(&pc.checks(), "swap").verdict, Verdict::Good);
    pc.write("/proc/self/limits", &limits("95", "8388608"));
    assert_eq!(named(&pc.checks(), "swap").verdict, Verdict::Better);
}

#[test]
fn unreadable_sources_give_unknown_verdicts() {
    let pc = Pc::new(&[]);
    let probe = Probe::with_root(pc.0.path().into(), None);
    let checks = examine(&probe, loop_cpu(&probe, None), PRIORITY);
    assert_eq!(checks.len(), 15);
    for check in &checks {
        // A missing USB or serial port needs no fix.
        let expected = if matches!(check.name, "usb" | "serial") { Verdict::Good } else { Verdict::Unknown };
        assert_eq!((check.verdict, check.fix.len()), (expected, 0), "{check}");
    }
}

#[test]
fn the_advice_is_for_the_requested_isolated_or_last_allowed_cpu() {
    let pc = good();
    assert_eq!(loop_cpu(&pc.probe(), None), 3);
    assert_eq!(loop_cpu(&pc.probe(), Some(1)), 1);
    pc.write("/sys/devices/system/cpu/isolated", "2\n");
    assert_eq!(loop_cpu(&pc.probe(), None), 2);
    pc.write("/sys/devices/system/cpu/isolated", "\n");
    pc.write("/proc/self/status", &STATUS.replace("0-3", "0-1"));
    assert_eq!(loop_cpu(&pc.probe(), None), 1);
}

#[test]
fn the_table_fits_a_terminal() {
    let pc = good();
    pc.write("/proc/self/limits", &limits("0", "8388608"));
    pc.write("/proc/cmdline", "quiet");
    pc.write("/proc/77/comm", "irqbalance");
    std::fs::remove_file(pc.path("/dev/cpu_dma_latency")).expect("it was there");
    for check in pc.checks() {
        for line in check.to_string().lines() {
            assert!(line.chars().count() <= WIDTH, "{} characters: {line}", line.chars().count());
        }
    }
}

#[test]
fn a_session_reports_its_system() {
    let pc = good();
    pc.write("/sys/devices/system/cpu/cpu1/cpufreq/scaling_governor", "schedutil\n");
    let text = SystemInfo::of(&pc.probe(), Some(3)).to_string();
    assert_eq!(
        text,
        "kernel       6.1.0-44-rt-amd64, PREEMPT_RT\nCPUs         governor performance; isolated: 3"
    );
    assert_eq!(SystemInfo::of(&pc.probe(), None).governor, "performance, schedutil");
    let nothing = Pc::new(&[]);
    assert!(SystemInfo::of(&nothing.probe(), None).to_string().contains("preemption unknown"));
}
