//! The section of the Z-width: tables over rate, damping and device.

use palpate_core::{Method, Organ};
use palpate_host::device::profile::{Damping, Profile};
use palpate_precompute::num::in_parallel;

use super::emulated::{Renderer, SECONDS, hold};
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

/// Columns beside those of the methods and of live; the last two ask for the energy alone.
pub(in crate::cmd::bench::public) const COLUMNS: [&str; 4] =
    ["plain wall", "guarded", "energy, 5 mJ", "guarded, 5 mJ"];
const ENERGY_ALONE: [&str; 2] = [COLUMNS[2], COLUMNS[3]];

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

/// What must hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Wanted {
    /// No energy for the hand, and no oscillation.
    Stillness,
    /// No energy for the hand.
    NoEnergy,
}

/// A column: its name, what renders, and what must hold.
#[derive(Debug, Clone)]
struct Column<'r> {
    name: String,
    renderer: Renderer<'r>,
    wanted: Wanted,
}

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
    let [wall, guarded, energy_alone, guarded_alone] = COLUMNS;
    let column = |name: &str, renderer, wanted| Column { name: name.to_owned(), renderer, wanted };
    let of = |method, guard| Renderer::Organ { organ, method, guard };
    let mut columns = vec![column(wall, Renderer::Wall, Wanted::Stillness)];
    for method in ready.scene.methods {
        columns.push(column(method.name(), of(*method, false), Wanted::Stillness));
    }
    columns.push(column(LIVE, Renderer::Live { ready, organ }, Wanted::Stillness));
    columns.push(column(guarded, of(Method::Energy, true), Wanted::Stillness));
    columns.push(column(energy_alone, of(Method::Energy, false), Wanted::NoEnergy));
    columns.push(column(guarded_alone, of(Method::Energy, true), Wanted::NoEnergy));
    columns
}

/// The largest stiffness of a case at which a column holds, N/m; NaN if there is none.
fn largest_n_m(column: &Column<'_>, profile: &Profile) -> Result<f64, Failure> {
    let Column { renderer, wanted, .. } = *column;
    let quantum_m = profile.mechanism.encoder_quantum_m.unwrap_or(0.0);
    let mut failure = None;
    let [low, high] = RANGE_N_M;
    // The energy is that of the first second.
    let seconds = if wanted == Wanted::Stillness { SECONDS } else { 1 };
    let mut held = |stiffness| match hold(renderer, stiffness, profile, seconds) {
        Ok(held) => wanted == Wanted::NoEnergy && held.gives_no_energy() || held.is_passive(quantum_m),
        Err(error) => {
            failure.get_or_insert(error);
            false
        }
    };
    let found = largest(low, high, SCAN, CLOSE, &mut held);
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
    let found = in_parallel(&jobs, context.threads, |&(case, column)| {
        context.go_on()?;
        largest_n_m(column, &case.profile)
    })
    .map_err(Failure::work)?;
    let values = found.into_iter().collect::<Result<Vec<f64>, Failure>>()?;
    table.columns = columns.iter().map(|column| column.name.clone()).collect();
    (table.others, table.accuracy) = (Others::Declared, CLOSE);
    table.apart = ENERGY_ALONE.map(String::from).to_vec();
    for (case, values) in cases.into_iter().zip(values.chunks(columns.len())) {
        table.rows.push(Row::new(case.row, case.name, Best::Most, values.to_vec()));
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
             devices K is the largest stiffness at which a held device comes to rest after a knock of 2.5 mN s. The hand then gets at \
             most 5 mJ in the second after the knock. Within three seconds it moves by less than three encoder steps (at least 20 \
             \u{b5}m), or by a fifth less than a second before. This is weaker than passivity in any motion, which the first table has. \
             Columns with \u{201c}5 mJ\u{201d} ask for the energy alone, so the hand may tremble; they are compared with each other only.",
            "The K of an organ is the stiffness of its skin at rest; an organ is made stiffer by multiplying all constants of its \
             materials. The methods and \
             \u{201c}live\u{201d} are in the controller without its limits of stiffness and energy; \u{201c}guarded\u{201d} is energy with the \
             energy guard. \u{201c}live\u{201d} solves beside the loop in simulated time, so it depends on this processor. Devices are held by \
             two fingers; an organ grows stiffer with depth, so its limit is often below that of a wall.",
            "The guard acts when its own balance passes 5 mJ: it stops a large limit cycle within a second or two, and lets one of a \
             millimetre that gives less go on. \u{201c}guarded\u{201d} has the K of the first cycle that is left, so it can fall from \
             one rate or damping to the next.",
        ],
        &[],
        start.elapsed().as_secs_f64(),
        vec![wall, springs, damping, devices],
    ))
}
