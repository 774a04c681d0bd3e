//! The certificate of a blob in few lines: verdict, health of its nodes, errors of its methods.

use std::cmp::Reverse;

use palpate_core::Method;
use palpate_host::PREFERENCE;
use palpate_precompute::certificate::{
    Certificate, Discretisation, Errors, MethodCertificate, Reason, SpaceCertificate, Verdict,
    certified_share,
};

use super::certificate::mn;
use crate::output::{self, Table};

/// Maximum number of nodes shown one by one; of more, the worst are shown.
const MAX_NODES: usize = 6;
/// Maximum number of reasons.
const MAX_REASONS: usize = 4;

/// The most severe verdict on a space.
pub(crate) fn verdict(certificate: &Certificate) -> Verdict {
    certificate.spaces.iter().map(verdict_of).max().unwrap_or_default()
}

fn verdict_of(space: &SpaceCertificate) -> Verdict {
    space.health.as_ref().map_or(Verdict::Green, |health| health.verdict)
}

/// The verdict with its meaning.
pub(crate) fn verdict_in_words(certificate: &Certificate) -> String {
    if certificate.spaces.iter().any(|space| space.health.is_none()) {
        return "UNKNOWN: it does not state whether it is numerically sound, so `palpate run` refuses it on a device with motors".into();
    }
    let verdict = verdict(certificate);
    let meaning = match verdict {
        Verdict::Green => "numerically sound",
        Verdict::Yellow => "usable after a look at the reasons",
        Verdict::Red => "not sound everywhere, `palpate run` refuses it on a device with motors",
    };
    format!("{}: {meaning}", output::verdict(verdict))
}

/// The verdict, the error of the method that `run` would choose, and that of the discretisation.
pub(crate) fn headline(certificate: &Certificate) -> String {
    let error = PREFERENCE.into_iter().find_map(|method| {
        let of = Together::of(certificate, method.name())?;
        let (name, max, count) = (method.name(), mn(of.max_n), of.count);
        Some(format!("{name} is within {max} mN of finite elements at {count} held-out positions"))
    });
    let mesh = certificate.discretisation.as_ref().map(Discretisation::in_words);
    [Some(verdict_in_words(certificate)), error, mesh].into_iter().flatten().collect::<Vec<_>>().join("\n")
}

/// Nodes, methods and reasons, at most 26 lines.
pub(crate) fn overview(certificate: &Certificate) -> String {
    let mut parts = vec![nodes(certificate), methods(certificate).to_string()];
    parts.extend(reasons(certificate));
    parts.join("\n\n")
}

/// The spaces, the worst first if there are too many.
pub(crate) fn nodes(certificate: &Certificate) -> String {
    let mut spaces: Vec<&SpaceCertificate> = certificate.spaces.iter().collect();
    if spaces.len() > MAX_NODES {
        spaces.sort_by_key(|space| Reverse(verdict_of(space)));
    }
    let header =
        ["node", "health", "configurations", "failed", "smallest J", "at branch jumps, %", "held-out"];
    let mut table = Table::new(2, header);
    for space in spaces.iter().take(MAX_NODES) {
        table.row([
            space.active.clone(),
            output::verdict(verdict_of(space)),
            space.cost.configurations.to_string(),
            space.cost.failed.to_string(),
            space.health.as_ref().map_or("-".into(), |health| format!("{:.2}", health.min_jacobian)),
            format!("{:.1}", 100.0 * space.branch_jump_volume),
            space.cost.held_out.to_string(),
        ]);
    }
    if spaces.len() <= MAX_NODES {
        return table.to_string();
    }
    let count = |verdict| spaces.iter().filter(|space| verdict_of(space) == verdict).count();
    let [green, yellow, red] = [Verdict::Green, Verdict::Yellow, Verdict::Red].map(count);
    format!("{table}\nof {} nodes, {green} green, {yellow} yellow, {red} red", spaces.len())
}

/// Errors of a method at the uniform positions of all spaces, away from branch jumps.
struct Together {
    count: usize,
    covered: usize,
    below_jnd: usize,
    mean_n: f64,
    /// Of the space where it is largest.
    p99_n: f64,
    max_n: f64,
    nanoseconds: f64,
}

impl Together {
    /// `None` if no position was measured.
    fn of(certificate: &Certificate, method: &str) -> Option<Self> {
        let of = || certificate.spaces.iter().flat_map(|s| &s.methods).filter(|m| m.method == method);
        let sum = |number: fn(&Errors) -> usize| of().map(|m| number(&m.uniform)).sum::<usize>();
        let largest = |number: fn(&MethodCertificate) -> f64| of().map(number).fold(0.0, f64::max);
        let count = sum(|e| e.count);
        (count > 0).then(|| Self {
            count,
            covered: sum(|e| e.covered),
            below_jnd: sum(|e| e.below_jnd),
            mean_n: of().map(|m| m.uniform.mean_n * m.uniform.count as f64).sum::<f64>() / count as f64,
            p99_n: largest(|m| m.uniform.p99_n),
            max_n: largest(|m| m.uniform.max_n),
            nanoseconds: largest(|m| m.probe.nanoseconds),
        })
    }
}

/// The methods over all spaces.
fn methods(certificate: &Certificate) -> Table {
    let header = [
        "force error",
        "mean, mN",
        "p99, mN",
        "max, mN",
        "covered, %",
        "< JND, %",
        "certified, %",
        "query, ns",
    ];
    let mut table = Table::new(1, header);
    let names: Vec<&str> =
        certificate.spaces.iter().flat_map(|s| &s.methods).map(|m| &m.method[..]).collect();
    for method in Method::ALL.into_iter().map(Method::name).filter(|name| names.contains(name)) {
        let percent = |share: f64| format!("{:.1}", 100.0 * share);
        table.row(match Together::of(certificate, method) {
            None => std::array::from_fn(|column| if column == 0 { method.into() } else { "-".into() }),
            Some(of) => [
                method.into(),
                mn(of.mean_n),
                mn(of.p99_n),
                mn(of.max_n),
                percent(of.covered as f64 / of.count as f64),
                percent(of.below_jnd as f64 / of.count as f64),
                percent(certified_share(of.count, of.count - of.below_jnd)),
                format!("{:.0}", of.nanoseconds),
            ],
        });
    }
    table
}

/// Why spaces are not green; `None` if all are.
fn reasons(certificate: &Certificate) -> Option<String> {
    // One line for nodes with the same reason, such as that of their mesh.
    let mut all: Vec<(&Reason, Vec<&str>)> = Vec::new();
    for space in &certificate.spaces {
        for reason in space.health.iter().flat_map(|health| &health.reasons) {
            match all.iter_mut().find(|(known, _)| *known == reason) {
                Some((_, names)) => names.push(&space.active),
                None => all.push((reason, vec![&space.active])),
            }
        }
    }
    all.sort_by_key(|(reason, _)| Reverse(reason.verdict));
    let names = |of: &[&str]| if of.len() <= 3 { of.join(", ") } else { format!("{} nodes", of.len()) };
    let shown = all.iter().take(MAX_REASONS);
    let line = |(reason, of): &(&Reason, Vec<&str>)| {
        format!("{} {}: {}", reason.verdict.name(), names(of), reason.what)
    };
    let mut lines: Vec<String> = shown.map(line).collect();
    if all.len() > MAX_REASONS {
        lines.push(format!("and {} more reasons", all.len() - MAX_REASONS));
    }
    (!lines.is_empty()).then(|| lines.join("\n"))
}
