//! The verdict on many spaces that are certified together.
//!
//! Each of more than [`MAX_SEPARATE_NODES`] spaces has a few configurations and held-out positions: too few for a share. So
//! the limits are those of all spaces together, and what one space alone shows is at most yellow. Inverted elements,
//! instabilities and branch jumps in few of the configurations concern only the spaces that have them.

use super::{BranchDifference, Cost, Errors, MAX_SEPARATE_NODES, MethodCertificate, SpaceCertificate};
use super::{Health, Reason, Verdict};

/// Share of all configurations up to which what some of them show is said only of their spaces.
const FEW: f64 = 0.01;

/// Judges the spaces of a blob together, if they are many.
pub(super) fn judge(spaces: &mut [SpaceCertificate]) {
    if spaces.len() <= MAX_SEPARATE_NODES {
        return;
    }
    let together = of_all(spaces).judged(&sum(spaces), None);
    let together: Vec<Reason> = together
        .into_iter()
        .map(|reason| Reason { what: format!("all nodes together: {}", reason.what), ..reason })
        .collect();
    for health in spaces.iter_mut().filter_map(|space| space.health.as_mut()) {
        for reason in &mut health.reasons {
            reason.verdict = reason.verdict.min(Verdict::Yellow);
        }
        health.reasons.extend(together.iter().cloned());
        health.conclude();
    }
}

/// The counts of all spaces. The fits are judged by each space.
fn of_all(spaces: &[SpaceCertificate]) -> Health {
    let all = || spaces.iter().filter_map(|space| space.health.as_ref());
    let reachable = all().map(|health| health.reachable).sum();
    let sum = |of: fn(&Health) -> usize| not_few(all().map(of).sum(), reachable);
    Health {
        reachable,
        min_jacobian: all().map(|health| health.min_jacobian).fold(f64::INFINITY, f64::min),
        inverted: sum(|health| health.inverted),
        unstable: sum(|health| health.unstable),
        switched: sum(|health| health.switched),
        residual_n: all().map(|health| health.residual_n).fold(0.0, f64::max),
        ..Health::default()
    }
}

/// A number of configurations; 0 if it is a few of them.
fn not_few(count: usize, of: usize) -> usize {
    if count as f64 <= FEW * of as f64 { 0 } else { count }
}

/// The measurements of all spaces that a verdict needs.
fn sum(spaces: &[SpaceCertificate]) -> SpaceCertificate {
    let mut methods: Vec<MethodCertificate> = Vec::new();
    for method in spaces.iter().flat_map(|space| &space.methods) {
        match methods.iter_mut().find(|sum| sum.method == method.method) {
            Some(sum) => add(sum, method),
            None => {
                let Errors { count, below_jnd, .. } = method.uniform;
                let uniform = Errors { count, below_jnd, ..Errors::default() };
                let (method, tolerated) = (method.method.clone(), method.tolerated);
                methods.push(MethodCertificate {
                    method,
                    uniform,
                    tolerated,
                    ..MethodCertificate::default()
                });
            }
        }
    }
    let apart_n = spaces.iter().map(|space| space.two_solutions.apart_n).fold(0.0, f64::max);
    let reachable =
        spaces.iter().filter_map(|space| space.health.as_ref()).map(|health| health.reachable).sum();
    let volume = spaces.iter().map(|space| space.branch_jump_volume).sum::<f64>() / spaces.len() as f64;
    SpaceCertificate {
        cost: Cost {
            configurations: spaces.iter().map(|space| space.cost.configurations).sum(),
            failed: spaces.iter().map(|space| space.cost.failed).sum(),
            ..Cost::default()
        },
        branch_jump_pairs: spaces.iter().map(|space| space.branch_jump_pairs).sum(),
        branch_jump_volume: if volume <= FEW { 0.0 } else { volume },
        two_solutions: BranchDifference {
            points: not_few(spaces.iter().map(|space| space.two_solutions.points).sum(), reachable),
            apart_n,
        },
        methods,
        ..SpaceCertificate::default()
    }
}

fn add(sum: &mut MethodCertificate, method: &MethodCertificate) {
    sum.uniform.count += method.uniform.count;
    sum.uniform.below_jnd += method.uniform.below_jnd;
    if let (Some(sum), Some(more)) = (&mut sum.tolerated, &method.tolerated) {
        sum.count += more.count;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `count` positions, of which `good` have an imperceptible error, and one of ten configurations unstable.
    fn space(count: usize, good: usize, unstable: usize) -> SpaceCertificate {
        let uniform = Errors { count, below_jnd: good, ..Errors::default() };
        let method = MethodCertificate { method: "energy".into(), uniform, ..MethodCertificate::default() };
        let mut space = SpaceCertificate {
            cost: Cost { configurations: 10, ..Cost::default() },
            methods: vec![method],
            ..SpaceCertificate::default()
        };
        let health = Health { reachable: 10, unstable, min_jacobian: 0.5, ..Health::default() };
        let reasons = health.judged(&space, None);
        let mut health = Health { reasons, ..health };
        health.conclude();
        space.health = Some(health);
        space
    }

    fn verdicts(mut spaces: Vec<SpaceCertificate>) -> (Verdict, Verdict) {
        judge(&mut spaces);
        let of = |space: &SpaceCertificate| space.health.as_ref().expect("it was judged").verdict;
        (of(&spaces[0]), of(&spaces[1]))
    }

    #[test]
    fn a_few_bad_places_among_many_are_yellow_and_a_bad_share_is_red() {
        let many = |bad: usize| {
            (0..400).map(|n| if n < bad { space(3, 0, 1) } else { space(3, 3, 0) }).collect::<Vec<_>>()
        };
        assert_eq!(verdicts(many(0)), (Verdict::Green, Verdict::Green));
        // 1 of 400: 0.25 % of the positions, 0.025 % of the configurations.
        assert_eq!(verdicts(many(1)), (Verdict::Yellow, Verdict::Green));
        // 2 % of the positions, 0.2 % of the configurations.
        assert_eq!(verdicts(many(8)), (Verdict::Yellow, Verdict::Yellow));
        // 2 % of the configurations.
        let unstable: Vec<_> = (0..400).map(|n| space(3, 3, usize::from(n < 80))).collect();
        assert_eq!(verdicts(unstable).1, Verdict::Red);
        assert_eq!(verdicts(many(100)).1, Verdict::Red);
        // A few spaces are judged one by one.
        assert_eq!(verdicts(vec![space(300, 200, 0), space(300, 300, 0)]), (Verdict::Red, Verdict::Green));
    }

    #[test]
    fn a_space_without_positions_is_judged_by_the_others() {
        let mut spaces: Vec<_> = (0..20).map(|_| space(30, 30, 0)).collect();
        spaces[0] = space(0, 0, 0);
        assert_eq!(verdicts(spaces), (Verdict::Yellow, Verdict::Green));
    }
}
