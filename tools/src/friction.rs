//! Where Coulomb friction has no effect.

use palpate_core::{Foot, Organ, TouchSurface};

/// Names that fit a line.
const NAMES: usize = 4;

/// The spaces at the corners of each triangle that the contact point slides over.
pub(crate) fn slid_over<const N: usize>(organ: &Organ<'_, N>) -> Vec<[u16; 3]> {
    let mut memory = vec![0; TouchSurface::words(organ)];
    let Some(surface) = TouchSurface::new(organ, &mut memory) else { return Vec::new() };
    let foot = |triangle| Foot { triangle, weights: [1.0, 0.0, 0.0] };
    let met = organ.met().triangles.len() as u32;
    let held = (0..met).filter_map(|at| surface.node_weights(&foot(at)));
    held.map(|nodes| nodes.map(|node| node.space)).collect()
}

/// The line about the active nodes from which the contact point cannot slide, or `None` if there are none.
///
/// A contact point slides over triangles whose three corners are active. At a node without such a triangle the tool stays
/// where it touched, as with infinite friction. The centre of a sphere slides everywhere.
pub(crate) fn without_effect<const N: usize>(organ: &Organ<'_, N>) -> Option<String> {
    if organ.tool.sphere().is_some() {
        return None;
    }
    let mut slides = vec![false; organ.spaces.len()];
    for space in slid_over(organ).into_iter().flatten() {
        slides[usize::from(space)] = true;
    }
    let stuck = organ.spaces.iter().zip(slides).filter(|(_, slides)| !slides);
    let names: Vec<&str> = stuck.map(|(space, _)| space.active.name.as_str()).collect();
    let listed = names[..names.len().min(NAMES)].join(", ");
    let others = match names.len().saturating_sub(NAMES) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    (!names.is_empty()).then(|| {
        format!(
            "friction has no effect at {listed}{others}: the contact point slides only over triangles with three active nodes (list the nodes round it in [[active]])"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_host::BlobFile;

    /// Of the two active nodes of this organ no triangle has three.
    #[test]
    fn nodes_from_which_nothing_slides_are_named() {
        let file = BlobFile::of(include_bytes!("../../firmware-like-core/golden/organ-514.blob"));
        let organ: Organ<'_> = Organ::read(file.bytes()).expect("a sound blob");
        let names: Vec<&str> = organ.spaces.iter().map(|space| space.active.name.as_str()).collect();
        let line = without_effect(&organ).expect("it cannot act");
        assert!(names.len() <= NAMES && names.iter().all(|name| line.contains(name)), "{line}");
        assert!(line.contains("[[active]]") && slid_over(&organ).is_empty(), "{line}");
    }
}
