//! Checks of the loop's CPU: its frequency, its sleep states, and its other users.

use super::Verdict::{Bad, Better, Good};
use super::probe::{Probe, cpus, list_of};
use super::{Check, Verdict};

/// Longest exit latency of a sleep state that does not disturb the loop, us.
const LONG_EXIT_US: u64 = 20;

fn folder(cpu: usize) -> String {
    format!("/sys/devices/system/cpu/cpu{cpu}")
}

/// Frequency governor of a CPU, if it has one.
pub(super) fn governor_of(probe: &Probe, cpu: usize) -> Option<String> {
    probe.read(&format!("{}/cpufreq/scaling_governor", folder(cpu)))
}

pub(super) fn governor(probe: &Probe, cpu: usize) -> Check {
    const NAME: &str = "governor";
    let online = probe.online();
    let of = |cpu: &usize| governor_of(probe, *cpu);
    let others: Vec<usize> =
        online.iter().copied().filter(|cpu| of(cpu).is_some_and(|name| name != "performance")).collect();
    let Some(own) = governor_of(probe, cpu) else {
        let found = "no cpufreq: firmware or hypervisor sets the frequency";
        return Check::new(NAME, Verdict::Unknown, found);
    };
    if own == "performance" && others.is_empty() {
        return Check::new(NAME, Good, "performance on every CPU");
    }
    let fix = ["$ apt install linux-cpupower && cpupower frequency-set -g performance"];
    if own == "performance" {
        let found = format!("performance on CPU {cpu}; not on CPU {}", list_of(&others));
        return Check::new(NAME, Good, found);
    }
    let found =
        format!("{own} on CPU {cpu}: it is slow after every sleep (not performance: {})", list_of(&others));
    Check::new(NAME, Better, found).fix(fix)
}

pub(super) fn idle(probe: &Probe, cpu: usize) -> Check {
    const NAME: &str = "idle";
    const HOLD: &str = "/dev/cpu_dma_latency";
    let base = format!("{}/cpuidle", folder(cpu));
    let states: Vec<(String, u64)> = probe
        .list(&base)
        .into_iter()
        .filter(|state| probe.number::<u32>(&format!("{base}/{state}/disable")) != Some(1))
        .filter_map(|state| {
            let latency_us = probe.number(&format!("{base}/{state}/latency"))?;
            Some((probe.read(&format!("{base}/{state}/name")).unwrap_or(state), latency_us))
        })
        .collect();
    let Some((name, latency_us)) = states.iter().max_by_key(|(_, latency_us)| *latency_us) else {
        return Check::new(NAME, Verdict::Unknown, format!("CPU {cpu} has no sleep states to read"));
    };
    let found = format!("deepest state {name} takes {latency_us} us to leave");
    match probe.may_write(HOLD) {
        _ if *latency_us <= LONG_EXIT_US => Check::new(NAME, Good, found),
        Some(true) => Check::new(NAME, Good, format!("{found}; the loop prevents it while it runs ({HOLD})")),
        may => {
            let why = if may.is_none() { "does not exist" } else { "is not writable" };
            Check::new(NAME, Better, format!("{found}, and {HOLD} {why}")).fix([
                "permit it (group realtime), or disable the sleep states:",
                "$ cp host/deploy/72-palpate.rules /etc/udev/rules.d/",
                "$ udevadm control --reload",
                "$ udevadm trigger --name-match=cpu_dma_latency",
                &format!("$ cpupower -c {cpu} idle-set -D {LONG_EXIT_US}"),
            ])
        }
    }
}

pub(super) fn isolation(probe: &Probe, cpu: usize) -> Check {
    const NAME: &str = "isolation";
    let online = probe.online();
    if online.len() == 1 {
        return Check::new(NAME, Bad, "one CPU for the loop, the viewer and all other processes")
            .fix(["use a PC with two or more CPUs"]);
    }
    let (Some(line), true) = (probe.read("/proc/cmdline"), !online.is_empty()) else {
        return Check::unknown(NAME, "/proc/cmdline or the list of CPUs");
    };
    let parameter = |name: &str| {
        let value = line.split_whitespace().find_map(|word| word.strip_prefix(name)?.strip_prefix('='));
        // isolcpus has flags before its list.
        value.is_some_and(|value| value == "all" || cpus(value).contains(&cpu))
    };
    let isolated = probe.read("/sys/devices/system/cpu/isolated");
    let is_isolated = parameter("isolcpus") || isolated.is_some_and(|list| cpus(&list).contains(&cpu));
    let parameters = [
        ("isolcpus", is_isolated),
        ("nohz_full", parameter("nohz_full")),
        ("rcu_nocbs", parameter("rcu_nocbs")),
    ];
    let missing: Vec<&str> = parameters.iter().filter(|(_, is)| !is).map(|(name, _)| *name).collect();
    if missing.is_empty() {
        return Check::new(
            NAME,
            Good,
            format!("CPU {cpu} is reserved for the loop if it is pinned (--cpu {cpu})"),
        );
    }
    let rest: Vec<usize> = online.iter().copied().filter(|other| *other != cpu).collect();
    let boot_line = format!(
        "+ isolcpus=domain,managed_irq,{cpu} nohz_full={cpu} rcu_nocbs={cpu} irqaffinity={}",
        list_of(&rest)
    );
    let found = format!("CPU {cpu} is shared with the rest of the system: no {}", missing.join(", "));
    Check::new(NAME, Better, found).fix([
        "add to GRUB_CMDLINE_LINUX in /etc/default/grub, then update-grub and reboot:",
        &boot_line,
        &format!("and pin the loop: palpate run --cpu {cpu}"),
    ])
}

pub(super) fn interrupts(probe: &Probe, cpu: usize) -> Check {
    const NAME: &str = "interrupts";
    let numbers: Vec<String> =
        probe.list("/proc/irq").into_iter().filter(|n| n.parse::<u32>().is_ok()).collect();
    if numbers.is_empty() {
        return Check::unknown(NAME, "/proc/irq");
    }
    let processes = probe.list("/proc").into_iter().filter(|name| name.parse::<u32>().is_ok());
    let is_balanced = processes
        .into_iter()
        .any(|id| probe.read(&format!("/proc/{id}/comm")).as_deref() == Some("irqbalance"));
    if is_balanced {
        return Check::new(NAME, Better, "irqbalance can move interrupts to the loop's CPU").fix([
            "$ systemctl disable --now irqbalance",
            "or keep it off the loop's CPU, in /etc/default/irqbalance:",
            &format!("+ IRQBALANCE_BANNED_CPULIST={cpu}"),
        ]);
    }
    // The effective affinity: the CPU that receives the interrupt now.
    let on_cpu: Vec<&String> = numbers
        .iter()
        .filter(|number| {
            let effective = probe.read(&format!("/proc/irq/{number}/effective_affinity_list"));
            effective.is_some_and(|list| cpus(&list).contains(&cpu))
        })
        .collect();
    if on_cpu.is_empty() {
        return Check::new(NAME, Good, format!("none of {} goes to CPU {cpu}, no irqbalance", numbers.len()));
    }
    let names: Vec<&str> = on_cpu.iter().take(8).map(|name| name.as_str()).collect();
    let more = if on_cpu.len() > names.len() { ", ..." } else { "" };
    let found =
        format!("{} of {} go to CPU {cpu} (number {}{more})", on_cpu.len(), numbers.len(), names.join(", "));
    let other_cpu = probe.online().into_iter().find(|other| *other != cpu).unwrap_or(0);
    Check::new(NAME, Better, found).fix([
        "boot with irqaffinity= (see isolation), or move a frequent one (see /proc/interrupts):",
        &format!("$ echo {other_cpu} > /proc/irq/NUMBER/smp_affinity_list"),
    ])
}

pub(super) fn siblings(probe: &Probe, cpu: usize) -> Check {
    const NAME: &str = "hyperthreads";
    let path = format!("{}/topology/thread_siblings_list", folder(cpu));
    let Some(list) = probe.read(&path) else { return Check::unknown(NAME, &path) };
    let others: Vec<usize> = cpus(&list).into_iter().filter(|other| *other != cpu).collect();
    if others.is_empty() {
        return Check::new(NAME, Good, format!("CPU {cpu} has a core to itself"));
    }
    let others_list = list_of(&others);
    let check = Check::new(NAME, Better, format!("CPU {cpu} shares its core with CPU {others_list}"));
    let lines = others.iter().map(|other| format!("$ echo 0 > {}/online", folder(*other)));
    let mut check = check.fix(["switch the sibling off (or all of them, with nosmt at boot):"]);
    check.fix.extend(lines);
    check
}

pub(super) fn load(probe: &Probe) -> Check {
    const NAME: &str = "load";
    const PATH: &str = "/proc/loadavg";
    let averages = probe.read(PATH).unwrap_or_default();
    let Some(Ok(load)) = averages.split_whitespace().next().map(str::parse::<f64>) else {
        return Check::unknown(NAME, PATH);
    };
    let count = probe.online().len().max(1);
    let found = format!("{load:.1} on {count} CPUs over the last minute");
    if load > 0.5 * count as f64 {
        return Check::new(NAME, Better, found)
            .fix(["find the other processes; the measurement was disturbed by them", "$ top"]);
    }
    Check::new(NAME, Good, found)
}
