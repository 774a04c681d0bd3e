//! Which jets are kept, and what stands in for a contact point without any.

use palpate_core::vec3::{self, Vec3};
use palpate_core::{Coverage, Field, Jet, JetFlags, JetMemory};

use crate::common::Random;
use crate::common::jets::{Tool, flat};

fn at(x_mm: f32) -> Vec3 {
    [1e-3 * x_mm, 0.0, 0.0]
}

/// A jet whose force is its number.
fn numbered(contact: u16, x_mm: f32, number: f32) -> Jet {
    flat(contact, at(x_mm), [number, 0.0, 0.0])
}

/// The force without the fade from the tick before.
fn fresh<const C: usize, const J: usize>(tool: &mut Tool<C, J>, d: Vec3) -> f32 {
    tool.release();
    tool.at(d).force_n[0]
}

#[test]
fn the_nearest_jet_in_trust_radii_is_found() {
    let mut random = Random(1);
    for count in [1, 7, 8, 9, 200, 256] {
        let jets: Vec<Jet> = (0..count)
            .map(|n| Jet {
                trust_m: 2e-3 + 0.02 * random.next().abs(),
                ..flat(0, random.point(0.03), [n as f32, 1.0, 0.0])
            })
            .collect();
        let mut tool = Tool::<1, 256>::new(&[(0, 1.0)]);
        tool.learn(jets.iter().copied());
        assert_eq!(tool.memory.jets(0), count);
        for _ in 0..300 {
            let d = random.point(0.04);
            let distance = |jet: &&Jet| vec3::distance(jet.control_m, d) / jet.trust_m;
            let nearest = jets.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).expect("some");
            tool.release();
            let found = tool.at(d);
            assert_eq!(found.force_n, nearest.force_n);
            assert_eq!(found.coverage == Coverage::Scattered, distance(&nearest) <= 1.0);
        }
        for d in [[f32::MAX; 3], [-1e30, 0.0, 1e-40]] {
            tool.release();
            assert!(vec3::is_finite(tool.at(d).force_n));
        }
    }
}

/// A removed jet leaves no trace in the search.
#[test]
fn after_a_flush_the_nearest_of_the_rest_is_found() {
    let mut random = Random(2);
    let flags = JetFlags { flush_before: true, ..JetFlags::default() };
    for _ in 0..200 {
        let mut tool = Tool::<1, 16>::new(&[(0, 1.0)]);
        // Every fifth one contradicts the last. Twelve remain, not a multiple of eight.
        let jets: Vec<Jet> = (0..14)
            .map(|n| flat(0, random.point(0.02), [if n % 5 == 3 { 5.0 } else { 1.0 }, 1e-3 * n as f32, 0.0]))
            .collect();
        let last = Jet { flags, ..flat(0, random.point(0.02), [1.0, -0.01, 0.0]) };
        tool.learn(jets.iter().copied().chain([last]));
        assert_eq!(tool.memory.jets(0), 12);
        let rest: Vec<Jet> = jets.into_iter().filter(|jet| jet.force_n[0] < 2.0).chain([last]).collect();
        for _ in 0..20 {
            let d = random.point(0.03);
            let distance = |jet: &&Jet| vec3::distance(jet.control_m, d);
            let nearest = rest.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).expect("some");
            tool.release();
            assert_eq!(tool.at(d).force_n, nearest.force_n);
        }
    }
}

/// Also while the tool touches: the solver does the same and does not know where the tool is when the jet arrives.
#[test]
fn a_full_table_forgets_the_jet_farthest_from_the_new_one() {
    let mut tool = Tool::<1, 8>::new(&[(0, 1.0)]);
    tool.learn((0..8).map(|n| numbered(0, 10.0 * n as f32, n as f32)));
    tool.at(at(0.0));
    tool.learn([numbered(0, 65.0, 8.0)]);
    assert_eq!(tool.memory.jets(0), 8);
    assert_eq!((fresh(&mut tool, at(65.0)), fresh(&mut tool, at(0.0))), (8.0, 1.0));
    tool.learn([numbered(0, -5.0, 9.0)]);
    assert_eq!((fresh(&mut tool, at(0.0)), fresh(&mut tool, at(70.0))), (9.0, 8.0));
}

#[test]
fn the_point_used_longest_ago_makes_room() {
    let mut tool = Tool::<3, 8>::new(&[(0, 1.0)]);
    tool.learn((0..3).map(|contact| numbered(contact, 0.0, f32::from(contact))));
    // Touched in the order 1, 0: point 2 was used longest ago, by its insertion.
    tool.hold(&[(1, 1.0)]);
    tool.at(at(0.0));
    tool.hold(&[(0, 1.0)]);
    tool.at(at(0.0));
    tool.learn([numbered(7, 0.0, 7.0)]);
    let held = |tool: &Tool<3, 8>| [0, 1, 2, 7, 8].map(|contact| tool.memory.jets(contact));
    assert_eq!(held(&tool), [1, 1, 0, 1, 0]);
    tool.learn([numbered(8, 0.0, 8.0)]);
    assert_eq!(held(&tool), [1, 0, 0, 1, 1]);
    // An insertion is a use too, and a cleared table has no old jets.
    tool.learn([numbered(7, 20.0, 7.0), numbered(2, 0.0, 2.0)]);
    assert_eq!(held(&tool), [1, 0, 1, 2, 0]);
}

#[test]
fn a_point_of_the_present_touch_is_never_forgotten() {
    let mut tool = Tool::<2, 8>::new(&[(0, 0.5), (1, 0.5)]);
    tool.learn([numbered(0, 0.0, 1.0), numbered(1, 0.0, 3.0)]);
    assert_eq!(tool.at(at(0.0)).force_n[0], 2.0);
    assert!(!tool.memory.insert(&numbered(2, 0.0, 5.0)), "both tables are in use");
    assert_eq!(tool.at(at(0.0)).force_n[0], 2.0);
    tool.learn([numbered(1, 10.0, 4.0)]);
    tool.release();
    tool.learn([numbered(2, 0.0, 5.0)]);
    assert_eq!([0, 1, 2].map(|contact| tool.memory.jets(contact)), [0, 2, 1]);
    let mut none = JetMemory::<0, 8>::new();
    assert!(!none.insert(&numbered(0, 0.0, 1.0)));
}

#[test]
fn a_jet_out_of_range_is_refused() {
    let mut tool = Tool::<1, 8>::new(&[(0, 1.0)]);
    for bad in [
        Jet { trust_m: f32::NAN, ..numbered(0, 0.0, 1.0) },
        Jet { trust_m: 0.0, ..numbered(0, 0.0, 1.0) },
        numbered(0, 0.0, f32::INFINITY),
        numbered(0, 1_001.0, 1.0),
    ] {
        assert!(!tool.memory.insert(&bad), "{bad:?}");
    }
    assert_eq!(tool.memory.jets(0), 0);
}

/// Beyond 0.1 N and beyond 10 %.
#[test]
fn a_flush_removes_what_contradicts_the_new_jet() {
    let flags = JetFlags { flush_before: true, ..JetFlags::default() };
    for new_n in [0.5, 5.0] {
        let mut tool = Tool::<2, 8>::new(&[(0, 1.0)]);
        let most_n = f32::max(0.1, 0.1 * new_n);
        let shares = [-1.1, -0.98, 0.98, 1.1];
        // At places 10 mm apart.
        let place = |n: usize| 10.0 * (n as f32 + 1.0);
        let old = |n: usize| numbered(0, place(n), new_n + shares[n] * most_n);
        tool.learn((0..4).map(old));
        tool.learn([numbered(1, 0.0, 100.0)]);
        tool.learn([Jet { flags, ..numbered(0, 0.0, new_n) }]);
        assert_eq!((tool.memory.jets(0), tool.memory.jets(1)), (3, 1), "another point keeps its jets");
        for (n, share) in shares.iter().enumerate() {
            let is_kept = fresh(&mut tool, at(place(n))) == old(n).force_n[0];
            assert_eq!(is_kept, share.abs() < 1.0, "jet {n} of {new_n} N");
        }
    }
    // The force at the control of the new jet counts, not that at the old one.
    let sloped = Jet { stiffness_n_m: [100.0, 0.0, 0.0, 0.0, 0.0, 0.0], ..numbered(0, 10.0, 2.0) };
    let mut tool = Tool::<1, 8>::new(&[(0, 1.0)]);
    tool.learn([sloped, Jet { flags, ..numbered(0, 0.0, 1.0) }]);
    assert_eq!(tool.memory.jets(0), 2);
    tool.learn([Jet { flags, ..numbered(0, 0.0, 2.0) }]);
    assert_eq!(tool.memory.jets(0), 1);
}

#[test]
fn a_point_without_jets_takes_the_mean_of_the_others() {
    let mut tool = Tool::<3, 8>::new(&[(0, 0.5), (1, 0.2), (2, 0.3)]);
    let none = tool.at(at(0.0));
    assert_eq!((none.force_n, none.coverage), ([0.0; 3], Coverage::Extrapolated));
    assert_eq!(tool.memory.energy_j(1, at(0.0)), Some(0.0));
    tool.release();
    let energy = |energy_j: f32, jet: Jet| Jet { energy_j, ..jet };
    tool.learn([energy(0.1, numbered(0, 0.0, 1.0)), energy(0.2, numbered(2, 0.0, 3.0))]);
    let mean_n = (0.5 * 1.0 + 0.3 * 3.0) / 0.8;
    let found = tool.at(at(0.0));
    assert!((found.force_n[0] - mean_n).abs() < 1e-6, "{found:?}");
    assert_eq!(found.coverage, Coverage::Extrapolated, "not data of its own");
    let energies = [0, 1, 2].map(|space| tool.memory.energy_j(space, at(0.0)).expect("an energy"));
    let mean_j = (0.5 * 0.1 + 0.3 * 0.2) / 0.8;
    assert!((energies[1] - mean_j).abs() < 1e-7 && energies[0] == 0.1 && energies[2] == 0.2);
    // Its first jet takes over in 30 ms.
    tool.learn([numbered(1, 0.0, 8.0)]);
    let whole_n = 0.5 * 1.0 + 0.2 * 8.0 + 0.3 * 3.0;
    for tick in 0..40 {
        let found = tool.at(at(0.0));
        let exact_n = whole_n + (mean_n - whole_n) * (-(tick as f32) / 30.0).exp();
        assert!((found.force_n[0] - exact_n).abs() < 1e-5, "tick {tick}: {found:?} {exact_n}");
        assert_eq!(found.coverage, Coverage::Scattered);
    }
}

/// The tool slides off the only point with jets: the force fades out instead of stopping.
#[test]
fn the_force_fades_where_the_last_point_with_jets_is_left() {
    let mut tool = Tool::<3, 8>::new(&[(0, 0.3), (1, 0.7), (2, 0.0)]);
    tool.learn([numbered(0, 0.0, 2.0)]);
    assert_eq!(tool.at(at(0.0)).force_n[0], 2.0);
    tool.hold(&[(3, 0.0), (1, 0.7), (2, 0.3)]);
    for tick in 0..40 {
        let exact_n = 2.0 * (-(tick as f32) / 30.0).exp();
        let found_n = tool.at(at(0.0)).force_n[0];
        assert!((found_n - exact_n).abs() < 1e-5, "tick {tick}: {found_n} {exact_n}");
    }
}

/// The fixed part counts while the tool touches it, and no longer.
#[test]
fn the_stiffness_of_the_fixed_part_is_that_of_a_touch() {
    let mut tool = Tool::<1, 8>::new(&[(0, 1.0)]);
    let stiff = |z: f32, n_m: f32, fixed: bool| Jet {
        flags: JetFlags { fixed, ..JetFlags::default() },
        stiffness_n_m: [0.0, 0.0, 0.0, 0.0, 0.0, n_m],
        trust_m: 2e-3,
        ..flat(0, [0.0, 0.0, z], [0.0, 0.0, 5.0])
    };
    tool.learn([stiff(0.0, 300.0, false), stiff(0.01, 4_000.0, true)]);
    let stiffest = |tool: &Tool<1, 8>, force_n: f32| tool.memory.stiffest_n_m(force_n);
    tool.at([0.0; 3]);
    assert_eq!(stiffest(&tool, 8.0), 300.0, "not touched yet");
    tool.at([0.0, 0.0, 0.01]);
    assert_eq!([3.0, 8.0].map(|force_n| stiffest(&tool, force_n)), [0.0, 4_000.0], "in the band of 4 to 8 N");
    tool.at([0.0; 3]);
    assert_eq!(stiffest(&tool, 8.0), 4_000.0, "until the touch ends");
    tool.release();
    assert_eq!(stiffest(&tool, 8.0), 300.0);
}

#[test]
fn a_point_beyond_its_trust_takes_the_mean_of_those_within() {
    let mut tool = Tool::<4, 8>::new(&[(1, 0.6), (2, 0.4)]);
    let (near, far) = (at(0.0), at(50.0));
    tool.learn([flat(1, near, [1.0, 0.0, 0.0]), flat(2, far, [3.0, 0.0, 0.0])]);
    for (d, wanted) in [(near, 1.0), (far, 3.0)] {
        assert!((fresh(&mut tool, d) - wanted).abs() < 1e-5, "at {d:?}");
        assert_eq!(tool.at(d).coverage, Coverage::Extrapolated, "less than nine tenths are within");
    }
    // Between both only the weights count.
    assert!((fresh(&mut tool, at(25.0)) - 1.8).abs() < 1e-5);
    // Where it takes the place of the other one there is no step.
    tool.release();
    let mut before_n = tool.at(at(19.0)).force_n[0];
    for step in 1..=200 {
        let now_n = tool.at(at(19.0 + 0.01 * step as f32)).force_n[0];
        assert!((now_n - before_n).abs() < 0.03, "{before_n} {now_n}");
        before_n = now_n;
    }
    tool.hold(&[(1, 0.05), (2, 0.95)]);
    fresh(&mut tool, far);
    assert_eq!(tool.at(far).coverage, Coverage::Scattered);
}

/// Of some of the energies of a touch nobody knows where it slips.
#[test]
fn a_touch_does_not_slip_while_a_point_is_unknown() {
    let mut tool = Tool::<4, 8>::new(&[(1, 0.6), (2, 0.4)]);
    let d = at(1.0);
    tool.learn([flat(1, d, [1.0, 0.0, 0.0])]);
    tool.at(d);
    assert!(!tool.memory.slips(), "the second point has no jet");
    tool.after_us(9_900_000, d);
    assert!(!tool.memory.slips(), "nor later");
    tool.after_us(200_000, d);
    assert!(tool.memory.slips(), "nobody waits longer than ten seconds");
    tool.release();
    tool.at(d);
    assert!(!tool.memory.slips(), "a new touch waits anew");
    tool.learn([flat(2, d, [1.0, 0.0, 0.0])]);
    tool.at(d);
    assert!(tool.memory.slips(), "both are known");
    tool.at(at(100.0));
    assert!(tool.memory.slips(), "both are extrapolated alike");
}
