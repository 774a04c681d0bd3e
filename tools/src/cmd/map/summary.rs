//! The figures of a map: spreads over the places, and where an inclusion can be felt.

use palpate_precompute::map::{Compared, Found};
use serde::Serialize;

use super::Map;
use crate::output::Table;
use crate::words::{figure, milli, percent};

/// Smallest, middle and largest value of the places that have one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Spread {
    smallest: f64,
    median: f64,
    largest: f64,
    places: usize,
}

impl Spread {
    /// `None` without a value.
    fn of(values: impl Iterator<Item = f64>) -> Option<Self> {
        let mut values: Vec<f64> = values.collect();
        values.sort_by(f64::total_cmp);
        let (smallest, largest) = (*values.first()?, *values.last()?);
        Some(Self { smallest, median: values[values.len() / 2], largest, places: values.len() })
    }
}

/// Where an inclusion can be felt.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Felt {
    /// Volume of the inclusion, m^3.
    volume_m3: f64,
    /// Number of its tets.
    tets: usize,
    /// Detectability over the places, in just noticeable differences.
    detectability: Spread,
    /// Share of the free skin where it is above 1.
    pub(super) area_share: f64,
    /// Index of the place with the largest value.
    #[serde(skip)]
    strongest: usize,
    /// Node there.
    pub(super) node: u32,
    /// Position of this node, m.
    position_m: [f64; 3],
    depth_m: f64,
    force_n: f64,
    force_without_n: f64,
}

/// The figures of a map.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Summary {
    scene: String,
    elements: &'static str,
    /// Radius of the fingertip, m; none for a point.
    tool_radius_m: Option<f64>,
    force_n: f64,
    max_depth_m: f64,
    jnd_share: f64,
    jnd_least_n: f64,
    places: usize,
    area_m2: f64,
    stiffness_n_m: Option<Spread>,
    depth_m: Option<Spread>,
    /// Places where the force is not reached within the largest depth.
    below_force: usize,
    /// Places where a solve failed before.
    failed: usize,
    pub(super) inclusion: Option<Felt>,
    /// The place that a picture shows: the strongest signal, or the largest stiffness.
    #[serde(skip)]
    pub(super) shown: usize,
}

/// Detectability at every place.
pub(super) fn detectability(map: &Map) -> Vec<Option<f64>> {
    let of = |found: &Found| found.compared.map(|compared| compared.detectability(&map.jnd));
    map.found.iter().map(of).collect()
}

impl Summary {
    pub(super) fn of(map: &Map) -> Self {
        let Map { scene, found, places, goal, jnd, .. } = map;
        let stiffness = |place: &usize| found[*place].press.stiffness_n_m();
        let stiffest = (0..found.len()).max_by(|a, b| stiffness(a).total_cmp(&stiffness(b))).unwrap_or(0);
        let inclusion = felt(map);
        let is_failed = |found: &&Found| found.depth_m.is_none() && found.press.failure.is_some();
        let failed = found.iter().filter(is_failed).count();
        Self {
            scene: scene.name.clone(),
            elements: scene.elements(),
            tool_radius_m: scene.tool.fingertip().map(|tip| tip.radius_m),
            force_n: goal.force_n,
            max_depth_m: goal.max_depth_m,
            jnd_share: jnd.relative,
            jnd_least_n: jnd.absolute_n,
            places: found.len(),
            area_m2: places.area_m2(),
            stiffness_n_m: Spread::of(found.iter().map(|found| found.press.stiffness_n_m())),
            depth_m: Spread::of(found.iter().filter_map(|found| found.depth_m)),
            below_force: found.iter().filter(|found| found.depth_m.is_none()).count() - failed,
            failed,
            shown: inclusion.as_ref().map_or(stiffest, |felt| felt.strongest),
            inclusion,
        }
    }

    /// The tool in words.
    pub(super) fn tool(&self) -> String {
        match self.tool_radius_m {
            Some(radius_m) => format!("fingertip of {} mm", milli(radius_m)),
            None => "point tool".into(),
        }
    }

    /// The summary as text.
    pub(super) fn in_words(&self) -> String {
        let mut lines = vec![format!(
            "{}: {} places on {} cm\u{b2} of free skin, {}, {}\n",
            self.scene,
            self.places,
            figure(1e4 * self.area_m2),
            self.tool(),
            self.elements
        )];
        let mut table = Table::new(1, ["", "smallest", "median", "largest", "places"]);
        let mut row = |name: String, spread: Option<Spread>, unit: f64| {
            let Some(Spread { smallest, median, largest, places }) = spread else { return };
            let cells = [smallest, median, largest].map(|value| figure(unit * value));
            let [smallest, median, largest] = cells;
            table.row([name, smallest, median, largest, places.to_string()]);
        };
        row("stiffness at rest, N/m".into(), self.stiffness_n_m, 1.0);
        row(format!("depth at {} N, mm", figure(self.force_n)), self.depth_m, 1e3);
        row("detectability".into(), self.inclusion.as_ref().map(|felt| felt.detectability), 1.0);
        lines.push(table.to_string());
        if self.below_force > 0 {
            lines.push(format!(
                "{} of {} places stay below {} N down to {} mm.",
                self.below_force,
                self.places,
                figure(self.force_n),
                milli(self.max_depth_m)
            ));
        }
        if self.failed > 0 {
            lines
                .push(format!("{} of {} places: no equilibrium was found before.", self.failed, self.places));
        }
        lines.extend(self.inclusion.as_ref().map(|felt| self.felt_in_words(felt)));
        lines.join("\n")
    }

    fn felt_in_words(&self, felt: &Felt) -> String {
        format!(
            "\nThe inclusion ({} ml, {} tets) changes the force by more than the just noticeable difference ({}, at least \
             {} N)\non {} of the free skin. Most: {} times it at node {} ({} mm): {} N with it, {} N with it \
             replaced,\nat a depth of {} mm.",
            figure(1e6 * felt.volume_m3),
            felt.tets,
            percent(self.jnd_share),
            figure(self.jnd_least_n),
            percent(felt.area_share),
            figure(felt.detectability.largest),
            felt.node,
            felt.position_m.map(|x| format!("{:.1}", 1e3 * x)).join(", "),
            figure(felt.force_n),
            figure(felt.force_without_n),
            milli(felt.depth_m),
        )
    }
}

/// Where the inclusion can be felt; `None` without one, or if nothing could be compared.
fn felt(map: &Map) -> Option<Felt> {
    let inclusion = map.inclusion.as_ref()?;
    let values = detectability(map);
    let felt = |(place, value): (usize, &Option<f64>)| {
        value.filter(|value| *value > 1.0).map(|_| map.places.places[place].area_m2)
    };
    let area_m2: f64 = values.iter().enumerate().filter_map(felt).sum();
    let value = |place: &usize| values[*place].unwrap_or(-1.0);
    let strongest = (0..values.len()).max_by(|a, b| value(a).total_cmp(&value(b)))?;
    let Compared { depth_m, force_n, without_n, .. } = map.found[strongest].compared?;
    let place = &map.places.places[strongest];
    Some(Felt {
        volume_m3: inclusion.volume_m3,
        tets: inclusion.tets.len(),
        detectability: Spread::of(values.iter().flatten().copied())?,
        area_share: area_m2 / map.places.area_m2(),
        strongest,
        node: place.active.node,
        position_m: place.position_m,
        depth_m,
        force_n,
        force_without_n: without_n,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_has_the_middle_of_its_values() {
        let spread = Spread::of([3.0, 1.0, 2.0].into_iter()).expect("three values");
        assert_eq!(spread, Spread { smallest: 1.0, median: 2.0, largest: 3.0, places: 3 });
        assert_eq!(Spread::of(std::iter::empty()), None);
    }
}
