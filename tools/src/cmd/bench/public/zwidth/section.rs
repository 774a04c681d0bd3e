//! The section of the Z-width: tables over rate, damping and device.

use palpate_core::{Method, Organ};
use palpate_host::device::hand::HandConfig;
use palpate_host::device::impedance::ImpedanceConfig;
use palpate_host::device::profile::{Damping, Profile};
use palpate_precompute::num::in_parallel;

use super::emulated::{Renderer, hold};
use super::ideal::Device;
use super::largest;
use crate::cmd::bench::public::figures::{Best, Others, Row, Section, Table};
use crate::cmd::bench::public::organs::Ready;
use crate::cmd::bench::public::ours::LIVE;
use crate::cmd::bench::public::run::{Context, finished};
use crate::failure::Failure;

/// Name of the section.
pub(in crate::cmd::bench::public) const KEY: &str = "zwidth";
/// Names of its tables.
pub(in crate::cmd::bench::public) const WALL: &str = "zwidth.wall";
pub(in crate::cmd::bench::public) const SPRINGS: &str = "zwidth.springs";
pub(in crate::cmd::bench::public) const DAMPING: &str = "zwidth.damping";
pub(in crate::cmd::bench::public) const DEVICES: &str = "zwidth.devices";

/// Columns beside those of the methods and of live: a formula, the wall, and the organ with the energy guard.
pub(in crate::cmd::bench::public) const COLUMNS: [&str; 3] = ["bound", "plain wall", "guarded"];

/// Rates of the loop, Hz.
pub(in crate::cmd::bench::public) const RATES_HZ: [u32; 4] = [500, 1000, 2000, 4000];
/// The ideal device: mass, kg, and damping, N s/m.
const MASS_KG: f64 = 0.15;
const DAMPING_N_S_M: f64 = 1.0;
/// Emulated devices.
const PROFILES: [&str; 4] = ["falcon", "touch", "omega", "polhem"];
/// The device whose damping is varied.
const VARIED: &str = "omega";
/// Its damping, N s/m; a quick run has every second one.
const DAMPINGS_N_S_M: [f32; 5] = [0.25, 0.5, 1.0, 2.0, 4.0];
/// Range of the stiffness that is searched, N/m, the step of the scan, and the accuracy.
const RANGE_N_M: [f64; 2] = [50.0, 50_000.0];
const SCAN: f64 = 1.25;
const CLOSE: f64 = 0.02;

/// A column: its name, and what renders.
type Column<'r> = (String, Renderer<'r>);

/// Key of the row of a device at a rate.
fn device_row(name: &str, rate_hz: u32) -> String {
    format!("{name}.{rate_hz}_hz")
}

/// Keys of the rows of the device whose damping is varied.
pub(in crate::cmd::bench::public) fn damping_rows() -> Vec<String> {
    RATES_HZ.iter().flat_map(|rate| DAMPINGS_N_S_M.map(|damping| damping_row(*rate, damping))).collect()
}

/// Key of the row of a rate and a damping.
fn damping_row(rate_hz: u32, damping_n_s_m: f32) -> String {
    format!("{rate_hz}_hz.{damping_n_s_m}")
}

/// Keys of the rows of the bundled devices.
pub(in crate::cmd::bench::public) fn device_rows() -> Vec<String> {
    PROFILES.iter().flat_map(|name| RATES_HZ.map(|rate| device_row(name, rate))).collect()
}

/// The columns of the emulated devices: the wall, every method and live without the energy guard, then with it.
fn columns<'r>(ready: &'r Ready, organ: &'r Organ<'r>) -> Vec<Column<'r>> {
    let [_, wall, guarded] = COLUMNS.map(String::from);
    let of = |method, guard| Renderer::Organ { organ, method, guard };
    let methods = ready.scene.methods.iter().map(|method| (method.name().to_owned(), of(*method, false)));
    std::iter::once((wall, Renderer::Wall))
        .chain(methods)
        .chain([(LIVE.to_owned(), Renderer::Live { ready, organ }), (guarded, of(Method::Energy, true))])
        .collect()
}

/// The stability limit of a linear spring K with the damping b of device and hand, the period T and the delay d of the
/// link, N/m: b / (T / 2 + d), without friction, mass and encoder (docs/devices.md).
fn bound_n_m(profile: &Profile) -> f64 {
    let hand = HandConfig::LIGHT;
    let hand_n_s_m = 2.0 * hand.damping_ratio * (hand.stiffness_n_m * hand.mass_kg).sqrt();
    let delay_us = profile.position_delay_us + profile.force_delay_us;
    let hold_s = 1e-6 * (0.5 * f64::from(profile.period_us()) + f64::from(delay_us));
    f64::from(ImpedanceConfig::of(profile).drag.damping_n_s_m + hand_n_s_m) / hold_s
}

/// The largest stiffness at which the hand comes to rest, N/m; NaN if there is none.
fn largest_n_m(renderer: Renderer<'_>, profile: &Profile) -> Result<f64, Failure> {
    let quantum_m = profile.mechanism.encoder_quantum_m.unwrap_or(0.0);
    let mut failure = None;
    let [low, high] = RANGE_N_M;
    let mut is_still = |stiffness| match hold(renderer, stiffness, profile) {
        Ok(held) => held.is_still(quantum_m),
        Err(error) => {
            failure.get_or_insert(error);
            false
        }
    };
    let found = largest(low, high, SCAN, CLOSE, &mut is_still);
    failure.map_or(Ok(found.unwrap_or(f64::NAN)), Err)
}

/// The bundled profile at a rate.
fn profile(name: &str, rate_hz: u32) -> Result<Profile, Failure> {
    let found = Profile::bundled(name).ok_or_else(|| Failure::work(format!("no bundled profile {name}")))?;
    Ok(found.at_period(1_000_000 / rate_hz))
}

/// The wall of the ideal device: in any motion with the condition, and on springs.
fn walls(quick: bool) -> [Table; 2] {
    let rates = || RATES_HZ.iter().map(|rate| format!("{rate} Hz"));
    let mut any = Table::new(
        WALL,
        "Plain wall, ideal device, any motion of the hand",
        "Largest stiffness K, N/m, that gives no energy in any motion, against the virtual damping B of the wall, for a \
         device with b = 1 N s/m. \u{201c}bound\u{201d} is the condition of Colgate and Schenkel, K = 2 (b - B) / T: it checks the \
         simulation.",
        "virtual damping B, N s/m",
        rates().flat_map(|rate| [rate.clone(), format!("{rate} bound")]).collect(),
    );
    let mut springs = Table::new(
        SPRINGS,
        "The same wall, a mass of 0.15 kg in the hold of lossless springs",
        "Largest K at which the mass comes to rest on every spring, N/m. A spring has one resonance, so some virtual damping \
         helps; a hand that moves at half of the sampling rate is not among them.",
        "virtual damping B, N s/m",
        rates().collect(),
    );
    for tenths in (0..10).step_by(if quick { 3 } else { 1 }) {
        let virtual_n_s_m = 0.1 * f64::from(tenths);
        let devices = RATES_HZ.map(|rate| Device {
            mass_kg: MASS_KG,
            damping_n_s_m: DAMPING_N_S_M,
            period_s: 1.0 / f64::from(rate),
        });
        let name = format!("{virtual_n_s_m:.1}");
        let values =
            devices.iter().flat_map(|d| [d.stiffness_in_any_motion(virtual_n_s_m), d.bound(virtual_n_s_m)]);
        any.rows.push(Row::new(name.clone(), name.clone(), Best::None, values.collect()));
        let values = devices.iter().map(|device| device.stiffness_on_springs(virtual_n_s_m));
        springs.rows.push(Row::new(name.clone(), name, Best::None, values.collect()));
    }
    [any, springs]
}

/// A case of an emulated device.
struct Case {
    row: String,
    name: String,
    profile: Profile,
}

/// Fills a table with the largest stiffness of every case and column. Other systems state theirs.
fn emulated(
    mut table: Table,
    cases: Vec<Case>,
    columns: &[Column<'_>],
    context: &Context<'_>,
) -> Result<Table, Failure> {
    let jobs: Vec<(&Case, &Column<'_>)> =
        cases.iter().flat_map(|case| columns.iter().map(move |column| (case, column))).collect();
    let found = in_parallel(&jobs, context.threads, |&(case, (_, renderer))| {
        context.go_on()?;
        largest_n_m(*renderer, &case.profile)
    })
    .map_err(Failure::work)?;
    let values = found.into_iter().collect::<Result<Vec<f64>, Failure>>()?;
    let [bound, ..] = COLUMNS.map(String::from);
    table.columns =
        std::iter::once(bound.clone()).chain(columns.iter().map(|(name, _)| name.clone())).collect();
    (table.others, table.accuracy, table.apart) = (Others::Declared, CLOSE, vec![bound]);
    for (case, values) in cases.into_iter().zip(values.chunks(columns.len())) {
        let values = std::iter::once(bound_n_m(&case.profile)).chain(values.iter().copied());
        table.rows.push(Row::new(case.row, case.name, Best::Most, values.collect()));
    }
    Ok(table)
}

/// Measures the section on an organ whose first space is touched.
pub(in crate::cmd::bench::public) fn section(
    ready: &Ready,
    context: &Context<'_>,
) -> Result<Section, Failure> {
    let start = std::time::Instant::now();
    let [wall, springs] = walls(context.quick);
    let organ = ready.organ()?;
    let columns = columns(ready, &organ);
    let mut varied = Vec::new();
    for rate_hz in RATES_HZ {
        for damping in DAMPINGS_N_S_M.into_iter().step_by(if context.quick { 2 } else { 1 }) {
            let mut profile = profile(VARIED, rate_hz)?;
            profile.mechanism.damping = Some(Damping { n_s_m: damping, measured: true });
            (profile.mechanism.coulomb_n, profile.assumed.coulomb_n) = (None, 0.0);
            let name = format!("{rate_hz} Hz, {damping} N s/m");
            varied.push(Case { row: damping_row(rate_hz, damping), name, profile });
        }
    }
    let damping = Table::new(
        DAMPING,
        "Against the damping of the device",
        "Largest stiffness at the hand, N/m, on an emulated omega.3 with damping b and without Coulomb friction, held by two \
         fingers (1.1 N s/m) with 1 N and knocked once. Another system states the K without oscillation.",
        "rate, b",
        Vec::new(),
    );
    let damping = emulated(damping, varied, &columns, context)?;
    let mut bundled = Vec::new();
    for name in PROFILES {
        for rate_hz in RATES_HZ {
            let profile = profile(name, rate_hz)?;
            let shown = format!("{}, {rate_hz} Hz", profile.name);
            bundled.push(Case { row: device_row(name, rate_hz), name: shown, profile });
        }
    }
    let devices = Table::new(
        DEVICES,
        "On the bundled device profiles",
        "The same with mass, damping, Coulomb friction, encoder, motors and delays of each profile. A profile states \
         assumptions where its maker states nothing (docs/devices.md).",
        "device and rate",
        Vec::new(),
    );
    let devices = emulated(devices, bundled, &columns, context)?;
    Ok(finished(
        context,
        KEY,
        "Z-width: how stiff a loop can be and come to rest",
        &[
            "A sampled spring gives back more energy than it took: beyond a stiffness K the device hums or kicks. For emulated \
             devices K is the largest stiffness at which a held device comes to rest after a knock of 2.5 mN s. In the last quarter \
             of the first or third second the hand moves at most three encoder steps (20 \u{b5}m if larger), or in that of the third \
             a fifth less than in that of the second. In the first second it gets at most 5 mJ. This is weaker than passivity in any \
             motion, which the first table has.",
            "The K of an organ is the stiffness that the hand feels at rest along the normal. An organ is made stiffer by multiplying \
             all constants of its materials. Its force depends on the position only: it has no virtual damping. The methods and \
             \u{201c}live\u{201d} are in the controller without its limits of stiffness and energy; \u{201c}guarded\u{201d} is energy with \
             the energy guard. \u{201c}live\u{201d} solves beside the loop in simulated time, so it depends on this processor.",
            "\u{201c}bound\u{201d} is b / (T / 2 + d) with the damping b of device and hand, the period T and the delay d of the link: the \
             limit of a linear spring without friction, mass and encoder. It checks the emulation of the wall. A knock at high K lets \
             the hand leave the organ. Then the controller fades the force over 30 ms, which costs up to a fifth of K.",
            "The guard acts when its own balance passes 5 mJ: it stops a large limit cycle within a second or two, and lets one of a \
             millimetre that gives less go on. \u{201c}guarded\u{201d} is the K at which a cycle first remains; it may fall with the rate \
             or the damping.",
        ],
        &[],
        start.elapsed().as_secs_f64(),
        vec![wall, springs, damping, devices],
    ))
}
