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
const METHODS: &str = "zwidth.methods";

/// Columns of the emulated devices; the last ones ask for the energy alone.
pub(in crate::cmd::bench::public) const COLUMNS: [&str; 6] =
    ["plain wall", "trilinear", "energy", "energy, guarded", "energy, 5 mJ", "guarded, 5 mJ"];
const ENERGY_ALONE: &[&str] = &[COLUMNS[4], COLUMNS[5]];

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

/// A column: what renders, and what must hold.
type Column<'r> = (Renderer<'r>, Wanted);

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

/// The columns of the emulated devices, in the order of their names.
fn columns<'r>(organ: &'r Organ<'r>) -> Vec<Column<'r>> {
    let of = |method, guard| Renderer::Organ { organ, method, guard };
    let (free, guarded) = (of(Method::Energy, false), of(Method::Energy, true));
    vec![
        (Renderer::Wall, Wanted::Stillness),
        (of(Method::Trilinear, false), Wanted::Stillness),
        (free, Wanted::Stillness),
        (guarded, Wanted::Stillness),
        (free, Wanted::NoEnergy),
        (guarded, Wanted::NoEnergy),
    ]
}

/// The largest stiffness of a case at which a column holds, N/m; NaN if there is none.
fn largest_n_m((renderer, wanted): Column<'_>, profile: &Profile) -> Result<f64, Failure> {
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

/// The largest stiffness of every case and column, in the order of the cases.
fn all_of(cases: &[Case], columns: &[Column<'_>], context: &Context<'_>) -> Result<Vec<f64>, Failure> {
    let jobs: Vec<(usize, usize)> =
        (0..cases.len()).flat_map(|case| (0..columns.len()).map(move |column| (case, column))).collect();
    let found = in_parallel(&jobs, context.threads, |&(case, column)| {
        context.go_on()?;
        largest_n_m(columns[column], &cases[case].profile)
    })
    .map_err(Failure::work)?;
    found.into_iter().collect()
}

/// A table of cases by columns.
fn emulated(
    mut table: Table,
    cases: Vec<Case>,
    names: Vec<String>,
    columns: &[Column<'_>],
    context: &Context<'_>,
) -> Result<Table, Failure> {
    (table.columns, table.accuracy) = (names, CLOSE);
    let values = all_of(&cases, columns, context)?;
    for (case, values) in cases.into_iter().zip(values.chunks(columns.len())) {
        table.rows.push(Row::new(case.row, case.name, Best::Most, values.to_vec()));
    }
    Ok(table)
}

/// Every method of the organ, and live, on one device at every rate.
fn methods(ready: &Ready, context: &Context<'_>) -> Result<Table, Failure> {
    let organ = ready.organ()?;
    let methods = ready.scene.methods;
    let of = |&method: &Method| (Renderer::Organ { organ: &organ, method, guard: false }, Wanted::Stillness);
    let mut columns: Vec<Column<'_>> = methods.iter().map(of).collect();
    columns.push((Renderer::Live { ready, organ: &organ }, Wanted::Stillness));
    let names = methods.iter().map(|method| method.name().to_owned()).chain([LIVE.to_owned()]);
    let mut cases = Vec::new();
    for rate_hz in RATES_HZ {
        let profile = profile(VARIED, rate_hz)?;
        cases.push(Case { row: format!("{rate_hz}_hz"), name: format!("{rate_hz} Hz"), profile });
    }
    let table = Table::new(
        METHODS,
        "By method, on an emulated omega.3",
        "The same criterion for every method in the controller without its energy guard. \u{201c}live\u{201d} has the solver beside \
         the loop in simulated time, so it depends on this processor.",
        "rate",
        Vec::new(),
    );
    emulated(table, cases, names.collect(), &columns, context)
}

/// Measures the section on an organ whose first space is touched.
pub(in crate::cmd::bench::public) fn section(
    ready: &Ready,
    context: &Context<'_>,
) -> Result<Section, Failure> {
    let start = std::time::Instant::now();
    let [wall, springs] = walls(context.quick);
    let organ = ready.organ()?;
    let (columns, names) = (columns(&organ), COLUMNS.map(String::from).to_vec());
    let apart: Vec<String> = ENERGY_ALONE.iter().map(|name| (*name).to_owned()).collect();
    let mut varied = Vec::new();
    for rate_hz in RATES_HZ {
        for damping in DAMPINGS_N_S_M.into_iter().step_by(if context.quick { 2 } else { 1 }) {
            let mut profile = profile(VARIED, rate_hz)?;
            profile.mechanism.damping = Some(Damping { n_s_m: damping, measured: true });
            (profile.mechanism.coulomb_n, profile.assumed.coulomb_n) = (None, 0.0);
            let name = format!("{rate_hz} Hz, b = {damping} N s/m");
            varied.push(Case { row: damping_row(rate_hz, damping), name, profile });
        }
    }
    let mut damping = Table::new(
        DAMPING,
        "Against the damping of the device",
        "Largest stiffness at the hand, N/m, on an emulated omega.3 without Coulomb friction, held by two \
         fingers (1.1 N s/m) with 1 N and knocked once. Another system states the K without oscillation.",
        "rate and damping b of the device",
        Vec::new(),
    );
    (damping.others, damping.apart) = (Others::Declared, apart.clone());
    let damping = emulated(damping, varied, names.clone(), &columns, context)?;
    let mut bundled = Vec::new();
    for name in PROFILES {
        for rate_hz in RATES_HZ {
            let profile = profile(name, rate_hz)?;
            let shown = format!("{}, {rate_hz} Hz", profile.name);
            bundled.push(Case { row: device_row(name, rate_hz), name: shown, profile });
        }
    }
    let mut devices = Table::new(
        DEVICES,
        "On the bundled device profiles",
        "The same with mass, damping, Coulomb friction, encoder, motors and delays of each profile. A profile states \
         assumptions where its maker states nothing (docs/devices.md).",
        "device and rate",
        Vec::new(),
    );
    (devices.others, devices.apart) = (Others::Declared, apart);
    let devices = emulated(devices, bundled, names, &columns, context)?;
    let methods = methods(ready, context)?;
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
             materials. \u{201c}trilinear\u{201d} and \
             \u{201c}energy\u{201d} are methods in the controller without its limits of stiffness and energy; \u{201c}guarded\u{201d} adds the energy guard. \
             Devices are held by two fingers; an organ grows stiffer with depth, so its limit is often below that of a wall. \
             The guard acts when its own balance passes 5 mJ, so it stops a small limit cycle only after a second or two.",
        ],
        &[],
        start.elapsed().as_secs_f64(),
        vec![wall, springs, damping, methods, devices],
    ))
}
