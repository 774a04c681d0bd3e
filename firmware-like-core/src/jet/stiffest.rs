//! The largest stiffness of the jets so far, by the force at which it is.

/// Upper ends of the bands of force, newtons; the last band has none.
const BANDS_N: [f32; 7] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0];

/// The largest stiffness in each band, N/m.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Stiffest {
    bands_n_m: [f32; 8],
}

impl Stiffest {
    /// Counts a stiffness at a force.
    pub(super) fn add(&mut self, force_n: f32, stiffness_n_m: f32) {
        let band = BANDS_N.iter().take_while(|end_n| force_n > **end_n).count();
        if let Some(most_n_m) = self.bands_n_m.get_mut(band) {
            *most_n_m = most_n_m.max(stiffness_n_m);
        }
    }

    /// The largest one in the bands that begin below a force.
    pub(super) fn below_n_m(&self, force_n: f32) -> f32 {
        let starts_n = core::iter::once(&0.0).chain(&BANDS_N);
        let reached = self.bands_n_m.iter().zip(starts_n).filter(|(_, start_n)| **start_n < force_n);
        reached.map(|(most_n_m, _)| *most_n_m).fold(0.0, f32::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_hand_does_not_reach_does_not_count() {
        let mut stiffest = Stiffest::default();
        assert_eq!(stiffest.below_n_m(f32::INFINITY), 0.0);
        for (force_n, stiffness_n_m) in
            [(0.5, 300.0), (3.0, 800.0), (3.5, 700.0), (24.0, 2_000.0), (1e3, 9_000.0)]
        {
            stiffest.add(force_n, stiffness_n_m);
        }
        for (force_n, most_n_m) in
            [(0.9, 300.0), (2.5, 800.0), (8.0, 800.0), (20.0, 2_000.0), (70.0, 9_000.0)]
        {
            assert_eq!(stiffest.below_n_m(force_n), most_n_m, "{force_n}");
        }
        stiffest.add(f32::NAN, 1.0);
    }
}
