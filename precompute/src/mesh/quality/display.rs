//! Text form of a mesh report, at most 80 columns wide except for group names and warnings.

use std::fmt;

use super::{MIN_BIN_DEG, MeshReport, Range, SIZE_JUMP, SLIVER_DEG};
use crate::error::count;

/// Number of marks of the histogram's longest bar.
const BAR: usize = 50;
/// Above this share of nodes on the surface, the body has too few inner nodes to deform well.
const MAX_SURFACE_SHARE: f64 = 0.9;

impl MeshReport {
    /// Defects of the mesh, one line each with the fix.
    pub fn warnings(&self) -> Vec<String> {
        let mut said = Vec::new();
        let has = |n: usize| if n == 1 { "has" } else { "have" };
        let s = &self.slivers;
        if s.below_5_deg > 0 {
            said.push(format!(
                "{} {} a dihedral angle below {SLIVER_DEG} degrees, {} of them below 1 (worst: tet {}, {:.2} degrees): \
                 optimise the mesh (Gmsh: Netgen optimiser)",
                count(s.below_5_deg, "sliver"),
                has(s.below_5_deg),
                s.below_1_deg,
                self.worst_tet,
                self.min_dihedral_deg.min
            ));
        }
        if self.tets_without_interior_vertex > 0 {
            said.push(format!(
                "{} of {} {} no vertex inside the body: doubtful for pressures (P2/P1); refine there",
                self.tets_without_interior_vertex,
                count(self.tets, "tet"),
                has(self.tets_without_interior_vertex)
            ));
        }
        if self.size_jumps.pairs > 0 {
            let [a, b] = self.size_jumps.worst_pair;
            said.push(format!(
                "{} of neighbouring tets {} volumes more than {SIZE_JUMP} times apart (worst: tets {a} and {b}, {:.0} \
                 times): grade the mesh more gently",
                count(self.size_jumps.pairs, "pair"),
                has(self.size_jumps.pairs),
                self.size_jumps.worst_ratio
            ));
        }
        if self.pieces > 1 {
            said.push(format!(
                "{} separate pieces, the largest with {:.1} % of the volume: merge coincident nodes or remove the rest",
                self.pieces,
                100.0 * self.largest_piece_share
            ));
        }
        let s = &self.surface;
        said.extend(s.topology.warning());
        let hanging = self.tets_by_free_faces[3] + self.tets_by_free_faces[4];
        if hanging > 0 {
            said.push(format!(
                "{} with three or four faces on the surface {} by one face or less: remove or refine",
                count(hanging, "tet"),
                if hanging == 1 { "hangs" } else { "hang" }
            ));
        }
        if s.node_share > MAX_SURFACE_SHARE {
            said.push(format!(
                "{:.0} % of the nodes are on the surface: the body is about one tet thick; refine it",
                100.0 * s.node_share
            ));
        }
        said
    }
}

impl fmt::Display for MeshReport {
    /// The warnings, then the figures; the alternate form `{:#}` adds the histogram of the dihedral angles.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let warnings = self.warnings();
        match &warnings[..] {
            [] => writeln!(f, "no warnings")?,
            _ => writeln!(f, "warning: {}", warnings.join("\nwarning: "))?,
        }
        let mm = |c: f64| 1e3 * c;
        let point = |x: [f64; 3]| x.map(|c| format!("{:.2}", mm(c))).join(", ");
        let [x, y, z] = [0, 1, 2].map(|axis| mm(self.high_m[axis] - self.low_m[axis]));
        let s = &self.surface;
        writeln!(
            f,
            "nodes           {} ({} on the surface, {:.0} %)",
            self.nodes,
            s.nodes,
            100.0 * s.node_share
        )?;
        writeln!(f, "tets            {} in {}", self.tets, count(self.pieces, "piece"))?;
        writeln!(
            f,
            "edges           {}: order 2 adds as many nodes, {} in all",
            self.edges,
            self.nodes + self.edges
        )?;
        writeln!(f, "size            {x:.1} x {y:.1} x {z:.1} mm, volume {:.3} ml", 1e6 * self.volume_m3)?;
        writeln!(f, "                from {} to {} mm", point(self.low_m), point(self.high_m))?;
        let area = 1e4 * s.area_m2;
        writeln!(
            f,
            "surface         {} triangles, {area:.1} cm2, {}",
            s.triangles,
            count(s.topology.pieces, "piece")
        )?;
        let manifold = if s.manifold { "closed manifold" } else { "NOT a closed manifold" };
        writeln!(f, "                {manifold}, Euler characteristic {}", s.topology.euler_characteristic)?;
        let [none, one, two, three, four] = self.tets_by_free_faces;
        writeln!(f, "free faces      0: {none}, 1: {one}, 2: {two}, 3: {three}, 4: {four} tets")?;
        let Range { min, median, max, .. } = self.edge_m;
        writeln!(
            f,
            "edge lengths    {:.2} to {:.2} mm, median {:.2} mm, ratio {:.1}",
            mm(min),
            mm(max),
            mm(median),
            max / min
        )?;
        let Range { min, median, max, .. } = self.tet_volume_m3;
        let mm3 = |v: f64| 1e9 * v;
        writeln!(
            f,
            "tet volumes     {:.3e} to {:.3e} mm3, median {:.3e} mm3",
            mm3(min),
            mm3(max),
            mm3(median)
        )?;
        writeln!(f, "                of neighbours at most {:.1} times apart", self.size_jumps.worst_ratio)?;
        let Range { median, max, .. } = self.aspect;
        writeln!(f, "aspect          median {median:.2}, at most {max:.2} (1 for a regular tet)")?;
        let Range { min, max, .. } = self.dihedral_deg;
        writeln!(f, "dihedral angles {min:.1} to {max:.1} degrees; the smallest in tet {}", self.worst_tet)?;
        writeln!(f, "inside          {} tets have no vertex there", self.tets_without_interior_vertex)?;
        let groups = self.groups.iter().map(|group| {
            let tets = if group.tets > 0 { format!(", {}", count(group.tets, "tet")) } else { String::new() };
            format!("\"{}\" ({}{tets})", group.name, count(group.nodes, "node"))
        });
        let groups: Vec<String> = groups.collect();
        let groups = if groups.is_empty() { "none".into() } else { groups.join(", ") };
        write!(f, "groups          {groups}")?;
        if f.alternate() { self.write_histogram(f) } else { Ok(()) }
    }
}

impl MeshReport {
    /// Number of tets by their smallest dihedral angle.
    fn write_histogram(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Range { median, .. } = self.min_dihedral_deg;
        write!(f, "\nsmallest dihedral angle of each tet, degrees (median {median:.1}, regular tet 70.5)")?;
        let most = self.min_dihedral_histogram.iter().copied().max().unwrap_or(1).max(1);
        for (bin, &n) in self.min_dihedral_histogram.iter().enumerate() {
            let from = MIN_BIN_DEG * bin as f64;
            // A bin that is not empty has at least one mark, because the rare bad tets matter most.
            let bar = "#".repeat((BAR * n).div_ceil(most));
            write!(f, "\n  {from:>2.0} - {:>2.0} {n:>9} |{bar}", from + MIN_BIN_DEG)?;
        }
        Ok(())
    }
}
