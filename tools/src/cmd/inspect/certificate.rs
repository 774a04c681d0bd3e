//! The certificate of a blob as text.

use std::fmt::Write;
use std::path::Path;

use palpate_core::{Method, Organ};
use palpate_precompute::certificate::{
    BranchDifference, Certificate, Cost, DisplacementCertificate, Errors, Health, Ledger, Line,
    MethodCertificate, Reason, SpaceCertificate, SurfaceDistances, Verdict, Within, certified_share,
};

use super::scattered::in_words as linear_in_words;
use crate::failure::Failure;

/// The certificate of a blob, if it has one.
pub(crate) fn of(path: &Path, organ: &Organ<'_>) -> Result<Option<Certificate>, Failure> {
    let Some(bytes) = organ.certificate else { return Ok(None) };
    let unreadable = |error| {
        Failure::input(format!("{}: its certificate cannot be read ({error}); pack it again", path.display()))
    };
    serde_json::from_slice(bytes).map(Some).map_err(unreadable)
}

/// With more spaces than this the table combines them, and only those that are not green are shown
/// separately.
const MAX_TABLES: usize = 8;
/// Maximum number of spaces shown separately.
const MAX_SHOWN: usize = 5;

/// The tables of a certificate as text.
pub(crate) fn as_text(certificate: &Certificate) -> String {
    let mesh = certificate.discretisation.as_ref();
    let mut text = mesh.map_or_else(String::new, |of| format!("discretisation: {}\n\n", of.in_words()));
    if certificate.spaces.len() <= MAX_TABLES {
        return text + &tables(&certificate.spaces.iter().collect::<Vec<_>>());
    }
    text.push_str(&together(certificate));
    let felt = |space: &&SpaceCertificate| {
        let of = |m: &MethodCertificate| m.uniform.count - m.uniform.below_jnd;
        space.methods.iter().map(of).min().unwrap_or(0)
    };
    let verdict = |space: &&SpaceCertificate| space.health.as_ref().map_or(Verdict::Green, |h| h.verdict);
    let mut worst: Vec<&SpaceCertificate> = certificate.spaces.iter().collect();
    worst.sort_by_key(|space| {
        std::cmp::Reverse((verdict(space), space.switched_to_spacing_m.is_some(), felt(space)))
    });
    worst.retain(|space| verdict(space) > Verdict::Green);
    worst.truncate(MAX_SHOWN);
    if !worst.is_empty() {
        let _ = writeln!(text, "the {} worst nodes:\n", worst.len());
    }
    text + &tables(&worst)
}

/// All spaces as one: a position may be of any node.
fn together(certificate: &Certificate) -> String {
    let spaces = &certificate.spaces;
    let cost = |of: fn(&Cost) -> usize| spaces.iter().map(|space| of(&space.cost)).sum::<usize>();
    let seconds = |of: fn(&Cost) -> f64| spaces.iter().map(|space| of(&space.cost)).sum::<f64>();
    let count = |colour| {
        let has = |space: &&SpaceCertificate| space.health.as_ref().is_some_and(|h| h.verdict == colour);
        spaces.iter().filter(has).count()
    };
    let mut text = format!(
        "certificate of {} active nodes: {} configurations ({} failed, {:.0} s), {} held-out positions ({:.0} s)\n  health: {} green, {} \
         yellow, {} red\n",
        spaces.len(),
        cost(|c| c.configurations),
        cost(|c| c.failed),
        seconds(|c| c.seconds),
        cost(|c| c.held_out as usize),
        seconds(|c| c.held_out_seconds),
        count(Verdict::Green),
        count(Verdict::Yellow),
        count(Verdict::Red)
    );
    let methods: Vec<&str> = spaces.iter().flat_map(|s| &s.methods).map(|m| m.method.as_str()).collect();
    for method in Method::ALL.into_iter().filter(|m| methods.contains(&m.name())) {
        let of = || {
            spaces.iter().flat_map(|s| &s.methods).filter(|m| m.method == method.name()).map(|m| &m.uniform)
        };
        let sum = |number: fn(&Errors) -> usize| of().map(number).sum::<usize>();
        let (positions, below_jnd) = (sum(|e| e.count), sum(|e| e.below_jnd));
        let mean = of().map(|e| e.mean_n * e.count as f64).sum::<f64>() / positions.max(1) as f64;
        let _ = writeln!(
            text,
            "  {:<12} error below JND at {:.1} % of {positions} independent positions away from branch jumps ({:.1} % certified of a random such position \
             of a random node); mean {} mN, largest {} mN",
            method.name(),
            100.0 * below_jnd as f64 / positions.max(1) as f64,
            100.0 * certified_share(positions, positions - below_jnd),
            mn(mean),
            mn(of().map(|e| e.max_n).fold(0.0, f64::max))
        );
        let own = spaces.iter().flat_map(|s| &s.methods).filter(|m| m.method == method.name());
        let within: Option<usize> = own.map(|m| m.tolerated.map(|within| within.count)).sum();
        if let Some(within) = within {
            let _ = writeln!(
                text,
                "  {:<12} within the scene's tolerance at {:.1} % of them ({:.1} % certified)",
                "",
                100.0 * within as f64 / positions.max(1) as f64,
                100.0 * certified_share(positions, positions - within)
            );
        }
    }
    let eyes: Vec<_> = spaces.iter().filter_map(|space| space.displacement.as_ref()).collect();
    if !eyes.is_empty() {
        let count = eyes.iter().map(|eye| eye.uniform.count).sum::<usize>();
        let sum = eyes.iter().map(|eye| eye.uniform.rms_mean_mm * eye.uniform.count as f64).sum::<f64>();
        let largest =
            |of: fn(&DisplacementCertificate) -> f64| eyes.iter().map(|eye| of(eye)).fold(0.0, f64::max);
        let _ = writeln!(
            text,
            "  displacement mean rms {:.3} mm over {count} independent positions, maximum rms {:.3} mm, maximum at a node {:.3} mm; {} kB, {} modes",
            sum / count.max(1) as f64,
            largest(|eye| eye.uniform.rms_max_mm),
            largest(|eye| eye.uniform.max_mm),
            eyes.iter().map(|eye| eye.bytes).sum::<usize>() / 1000,
            eyes.iter().map(|eye| eye.modes).sum::<usize>()
        );
    }
    let linear = spaces.iter().filter(|space| space.linear.is_some()).count();
    if linear > 0 {
        let _ = writeln!(text, "  linear model suffices: at {linear} of the nodes");
    }
    let switched = spaces.iter().filter(|space| space.switched_to_spacing_m.is_some());
    let at = |space: &SpaceCertificate| {
        format!("{} ({:.0} % of its ball at branch jumps)", space.active, 100.0 * space.branch_jump_volume)
    };
    let switched: Vec<String> = switched.map(at).collect();
    if !switched.is_empty() {
        let _ =
            writeln!(text, "  branch jumps: a lattice replaced adaptive sampling at {}", switched.join(", "));
    }
    text
}

fn tables(spaces: &[&SpaceCertificate]) -> String {
    let mut text = String::new();
    for space in spaces {
        let cost = &space.cost;
        let _ = writeln!(
            text,
            "certificate of {}: {} configurations ({} tries, {} failed, {:.1} s, residual up to {:.1e} N), {} held-out \
             positions ({:.1} s)",
            space.active,
            cost.configurations,
            cost.tries,
            cost.failed,
            cost.seconds,
            cost.residual_n,
            cost.held_out,
            cost.held_out_seconds
        );
        if let Some(linear) = &space.linear {
            let _ = writeln!(text, "  {}", linear_in_words(linear));
        }
        if let Some(health) = &space.health {
            text.push_str(&of_health(health));
        }
        let _ = writeln!(
            text,
            "  branch jumps: {} pairs of neighbours, {:.1} % of the volume in cells with them{}",
            space.branch_jump_pairs,
            100.0 * space.branch_jump_volume,
            if space.branch_jump_volume > 0.0 { "; the certified errors exclude this volume" } else { "" }
        );
        for method in space.methods.iter().filter(|method| method.probe.work_at_branch_jumps.circles > 0) {
            let work = &method.probe.work_at_branch_jumps;
            let _ = writeln!(
                text,
                "  work around circles through branch jumps, {}: mean {:.2} %, maximum {:.2} % of the energy exchanged",
                method.method,
                100.0 * work.mean,
                100.0 * work.max
            );
        }
        let BranchDifference { points, apart_n } = space.two_solutions;
        if points > 0 {
            let _ = writeln!(
                text,
                "  two stable solutions at {points} points, with forces up to {apart_n:.2} N apart; the one of lower energy is packed"
            );
        }
        let _ = writeln!(
            text,
            "  error vector, mN      mean     p50     p95     p99     max  covered  < JND (certified)         at jumps: \
             mean / max"
        );
        for method in &space.methods {
            text.push_str(&line(method));
        }
        for method in &space.methods {
            let Some(within) = &method.tolerated else { continue };
            let Within { tolerance, count, certified } = within;
            let _ = writeln!(
                text,
                "    {:<14}within the scene's tolerance ({} % of |h| or {} mN) at {:.1} % of {} positions ({:.1} % certified)",
                method.method,
                significant(100.0 * tolerance.relative),
                significant(1e3 * tolerance.absolute_n),
                100.0 * *count as f64 / method.uniform.count.max(1) as f64,
                method.uniform.count,
                100.0 * certified
            );
        }
        let _ = writeln!(
            text,
            "  by radius, mean / max mN   0-1/2      1/2-3/4    3/4-1    paths mean / max     work, %    seam mN  f32 mN       \
             ns"
        );
        for method in &space.methods {
            text.push_str(&second_line(method));
        }
        if let Some(displacement) = &space.displacement {
            text.push_str(&of_surface(displacement));
        }
        if let Some(ledger) = &space.ledger {
            text.push_str(&of_ledger(ledger));
        }
    }
    text
}

fn of_health(health: &Health) -> String {
    let mut text = format!(
        "  health of this model: {} (smallest J {:.2}, residual up to {:.1e} N",
        health.verdict.name().to_uppercase(),
        health.min_jacobian,
        health.residual_n
    );
    if let Some(condition) = health.condition {
        let _ = write!(text, ", condition of the fit {condition:.0e}");
    }
    match (health.loop_passed, health.loop_stalled) {
        (_, true) => text.push_str(", adaptive sampling stagnated"),
        (Some(true), _) => text.push_str(", adaptive sampling passed"),
        (Some(false), _) => text.push_str(", adaptive sampling not within tolerance"),
        (None, _) => {}
    }
    text.push_str(")\n");
    for Reason { verdict, what } in &health.reasons {
        let _ = writeln!(text, "    {}: {what}", verdict.name());
    }
    text.push_str("    (without the discretisation error of mesh and element order: see `pack --ledger`, and `stiffer` in `plan`)\n");
    text
}

pub(super) fn mn(newtons: f64) -> String {
    let value = 1e3 * newtons;
    if value == 0.0 || value >= 100.0 {
        format!("{value:.0}")
    } else if value >= 10.0 {
        format!("{value:.1}")
    } else if value >= 0.01 {
        format!("{value:.2}")
    } else {
        format!("{value:.0e}")
    }
}

fn pair(errors: &Errors) -> String {
    if errors.count == 0 { "-".into() } else { format!("{}/{}", mn(errors.mean_n), mn(errors.max_n)) }
}

fn line(method: &MethodCertificate) -> String {
    let MethodCertificate { uniform: e, at_branch_jumps, .. } = method;
    if e.count == 0 {
        return format!(
            "    {:<14}no independent position away from branch jumps: no bound                {:>8} positions: {}\n",
            method.method,
            at_branch_jumps.count,
            pair(at_branch_jumps)
        );
    }
    let percent = |n: usize| 100.0 * n as f64 / e.count.max(1) as f64;
    let numbers: String =
        [e.mean_n, e.p50_n, e.p95_n, e.p99_n, e.max_n].iter().map(|x| format!("{:>8}", mn(*x))).collect();
    format!(
        "    {:<14}{numbers}  {:6.1}%  {:6.1}% ({:.1}%)  {:>8} positions: {}\n",
        method.method,
        percent(e.covered),
        percent(e.below_jnd),
        100.0 * method.below_jnd_certified,
        at_branch_jumps.count,
        pair(at_branch_jumps)
    )
}

fn second_line(method: &MethodCertificate) -> String {
    let [inner, middle, outer] = &method.by_radius;
    let paths = |errors: &Errors| if errors.count == 0 { "-".to_string() } else { pair(errors) };
    let probe = &method.probe;
    format!(
        "    {:<14} {:>16} {:>12} {:>12} {:>14} {:>12.2e} {:>8} {:>8} {:8.0}\n",
        method.method,
        pair(inner),
        pair(middle),
        pair(outer),
        paths(&method.random),
        100.0 * probe.work.mean,
        mn(probe.seam_n),
        mn(probe.rounding_n),
        probe.nanoseconds
    )
}

/// One line per omission: its effect and what it saves.
fn of_ledger(ledger: &Ledger) -> String {
    let bodies = match ledger.positions {
        0 => "element order and mesh: `pack --ledger`".to_owned(),
        positions => format!("{positions} positions with each altered body in {:.1} s", ledger.seconds),
    };
    let mut text = format!(
        "  ledger: approximations made (-) or possible (o), with their effect and cost; {bodies}\n    \
         {:<62} force, mN: mean      max   relative     < JND   surface, mm: rms      max   cost with   without\n",
        ""
    );
    for line in &ledger.lines {
        let Line { what, made, force, relative, surface, unit, cost } = line;
        let relative = relative.map_or_else(String::new, |share| format!("{:.1} %", 100.0 * share));
        let force = match force {
            Some(e) if e.count > 0 => format!(
                "{:>15} {:>8} {relative:>10} {:>7.1} %",
                mn(e.mean_n),
                mn(e.max_n),
                100.0 * e.below_jnd as f64 / e.count as f64
            ),
            Some(e) => format!("{:>15} {:>8} {:>10} {:>9}", "", mn(e.max_n), "", ""),
            None => format!("{:>15} {:>8} {:>10} {:>9}", "-", "-", "", ""),
        };
        let surface = match surface {
            Some(apart) => format!("{:>18.4} {:>8.4}", apart.rms_mean_mm, apart.max_mm),
            None => format!("{:>18} {:>8}", "-", "-"),
        };
        let sign = if *made { '-' } else { 'o' };
        let [with, without] = cost.map(significant);
        let _ = writeln!(text, "  {sign} {what:<62} {force}  {surface}  {with:>10} {without:>9} {unit}");
    }
    text
}

/// A value with three significant digits.
pub(crate) fn significant(value: f64) -> String {
    match value.abs() {
        0.0 => "0".into(),
        size if !(1e-3..1e4).contains(&size) => format!("{value:.1e}"),
        size if size >= 100.0 || value.fract() == 0.0 => format!("{value:.0}"),
        size if size >= 1.0 => format!("{value:.1}"),
        _ => format!("{value:.3}"),
    }
}

fn of_surface(surface: &DisplacementCertificate) -> String {
    let DisplacementCertificate { nodes, modes, slopes, outliers, bytes, raw_bytes, .. } = surface;
    let mut text = format!(
        "  displacement of {nodes} surface nodes: {modes} modes, {slopes} with slopes, {outliers} outliers; {bytes} bytes ({:.1} % of \
         f32), {:.0} us a surface\n    distance, mm         surfaces   rms mean      max   largest mean      max   (allowed at the \
         configurations: {} rms, {} max)\n",
        100.0 * *bytes as f64 / (*raw_bytes).max(1) as f64,
        surface.microseconds,
        surface.bound_rms_mm,
        surface.bound_max_mm
    );
    let rows = [
        ("configurations", &surface.configurations),
        ("held-out", &surface.uniform),
        ("  without slopes", &surface.uniform_trilinear),
        ("held-out at jumps", &surface.at_branch_jumps),
    ];
    for (name, apart) in rows {
        let SurfaceDistances { count, rms_mean_mm, rms_max_mm, max_mean_mm, max_mm } = apart;
        if *count > 0 && (*slopes > 0 || name != "  without slopes") {
            let _ = writeln!(
                text,
                "    {name:<20} {count:>8}   {rms_mean_mm:8.4} {rms_max_mm:8.4}   {max_mean_mm:12.4} {max_mm:8.4}"
            );
        }
    }
    text
}
