//! Element types of the Gmsh format by their number.

/// Treatment of an element type by this reader.
pub(super) enum Kind {
    Tet {
        nodes: usize,
    },
    /// Points, lines and triangles: their vertices become members of groups. The vertices are the first
    /// nodes.
    Lower {
        dimension: usize,
        vertices: usize,
        nodes: usize,
    },
    HigherOrder,
    Refused(&'static str),
}

pub(super) fn kind_of(element_type: u32) -> Kind {
    match element_type {
        15 => Kind::Lower { dimension: 0, vertices: 1, nodes: 1 },
        1 => Kind::Lower { dimension: 1, vertices: 2, nodes: 2 },
        8 => Kind::Lower { dimension: 1, vertices: 2, nodes: 3 },
        2 => Kind::Lower { dimension: 2, vertices: 3, nodes: 3 },
        9 => Kind::Lower { dimension: 2, vertices: 3, nodes: 6 },
        4 => Kind::Tet { nodes: 4 },
        11 => Kind::Tet { nodes: 10 },
        3 => Kind::Refused("quadrangle"),
        5 => Kind::Refused("hexahedron"),
        6 => Kind::Refused("prism"),
        7 => Kind::Refused("pyramid"),
        10 | 12..=14 | 16..=33 | 36..=65 | 71..=75 | 79..=93 => Kind::HigherOrder,
        _ => Kind::Refused("cell of unknown shape"),
    }
}
