//! The active node at which a session opens.

use palpate_core::{Organ, vec3};

/// Up to this number the active nodes are those that a scene names, in its order. More of them cover a part of
/// the skin.
pub const MAX_NAMED: usize = 24;
/// Share of the body's size by which skin may stand above the tangent plane of a place that bulges.
const FLAT: f32 = 0.02;

/// Index of the active node where a session opens: the first one of a few; of many that cover the skin the middle
/// of the broadest side that bulges, where a hand would begin. 0 without any.
///
/// The node x has the largest B (1 - C)^2; of equal ones it is the first. B is the sum over all nodes q of
/// w_q max(0, n.n_q) exp(-2 |x - x_q|^2 / R^2): the skin round it that faces the same way. C is the share of the
/// skin above its tangent plane. R is the root of the mean square of the distances from the mean place, and
/// 1 / w_q = sum_r exp(-20 |x_q - x_r|^2 / R^2): nodes that lie close together count less.
pub fn first_place<const N: usize>(organ: &Organ<'_, N>) -> usize {
    let spaces = &organ.spaces;
    if spaces.len() <= MAX_NAMED {
        return 0;
    }
    let places = || spaces.iter().map(|space| space.active.rest_position_m);
    let share = 1.0 / spaces.len() as f32;
    let middle_m = vec3::scale(places().fold(vec3::ZERO, vec3::add), share);
    let square_m2 = share * places().map(|place_m| vec3::distance(place_m, middle_m).powi(2)).sum::<f32>();
    let square_m2 = square_m2.max(f32::MIN_POSITIVE);
    let near =
        |one_m, other_m, factor: f32| (-factor * vec3::distance(one_m, other_m).powi(2) / square_m2).exp();
    let weights: Vec<f32> =
        places().map(|at_m| places().map(|other_m| near(at_m, other_m, 20.0)).sum::<f32>().recip()).collect();
    let all: f32 = weights.iter().sum();
    let merit = |index: usize| {
        let at = &spaces[index].active;
        let (mut broad, mut above) = (0.0, 0.0);
        for (space, weight) in spaces.iter().zip(&weights) {
            let other = &space.active;
            let alike = vec3::dot(other.outward_normal, at.outward_normal).max(0.0);
            broad += weight * alike * near(at.rest_position_m, other.rest_position_m, 2.0);
            let away_m = vec3::sub(other.rest_position_m, at.rest_position_m);
            let is_above = vec3::dot(away_m, at.outward_normal) > FLAT * square_m2.sqrt();
            above += if is_above { *weight } else { 0.0 };
        }
        broad * (1.0 - above / all).powi(2)
    };
    let found = (0..spaces.len()).map(|index| (index, merit(index)));
    found.fold((0, 0.0), |most, next| if next.1 > most.1 { next } else { most }).0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::{self, Shape};

    #[test]
    fn of_a_few_nodes_it_is_the_first() {
        let blob = synthetic::organ(&Shape { patch: 20, ..Shape::default() });
        let mut organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        assert_eq!((organ.spaces.len(), first_place(&organ)), (23, 0));
        organ.spaces.clear();
        assert_eq!(first_place(&organ), 0);
    }

    /// A plate whose back is hollow, with nodes close together at a corner of the front.
    #[test]
    fn of_many_nodes_it_is_the_middle_of_the_side_that_bulges() {
        let blob = synthetic::organ(&Shape { patch: 200, ..Shape::default() });
        let mut organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let mut places = Vec::new();
        for (x, y) in (-3..=3).flat_map(|x| (-3..=3).map(move |y| (0.01 * x as f32, 0.01 * y as f32))) {
            let hollow_m = 0.008 - 6.0 * (x * x + y * y);
            places.push(([x, y, -0.02 + hollow_m], [0.0, 0.0, -1.0]));
            places.push(([x, y, 0.0], [0.0, 0.0, 1.0]));
        }
        places.extend((0..60).map(|n| ([0.028 + 2e-5 * n as f32, 0.028, 0.0], [0.0, 0.0, 1.0])));
        organ.spaces.truncate(places.len());
        assert_eq!(organ.spaces.len(), places.len());
        for (space, (place_m, normal)) in organ.spaces.iter_mut().zip(places) {
            (space.active.rest_position_m, space.active.outward_normal) = (place_m, normal);
        }
        let place_m = organ.spaces[first_place(&organ)].active.rest_position_m;
        assert!(vec3::norm(place_m) < 0.011, "{place_m:?}");
    }
}
