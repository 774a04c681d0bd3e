//! The nodes of a `.space` file in one table.

use serde_json::Value;

use crate::output::Table;

/// Maximum number of nodes shown.
const MAX_NODES: usize = 16;

/// The table, and sums over all nodes.
pub(super) struct Summarised {
    table: Table,
    nodes: usize,
    complete: usize,
    solved: u64,
    failed: u64,
    branch_jumps: u64,
}

impl Summarised {
    pub(super) fn new() -> Self {
        let header = [
            "node",
            "state",
            "reachable",
            "beyond f_max",
            "failed",
            "not reached",
            "branch jumps",
            "inverted",
            "|h|, N",
            "solving, s",
        ];
        let table = Table::new(2, header);
        Self { table, nodes: 0, complete: 0, solved: 0, failed: 0, branch_jumps: 0 }
    }

    /// Adds a node by its figures.
    pub(super) fn take(&mut self, of: &Value) {
        let count = |key: &str| of[key].as_u64().unwrap_or(0);
        let number = |key: &str| of[key].as_f64().unwrap_or(0.0);
        let is_complete = of["complete"].as_bool().unwrap_or(false);
        self.nodes += 1;
        self.complete += usize::from(is_complete);
        self.solved += count("expandable") + count("terminating");
        self.failed += count("failed");
        self.branch_jumps += count("branch_jumps");
        if self.nodes > MAX_NODES {
            return;
        }
        self.table.row([
            of["name"].as_str().unwrap_or("").into(),
            if is_complete { "complete".into() } else { "not finished".into() },
            count("expandable").to_string(),
            count("terminating").to_string(),
            count("failed").to_string(),
            count("unknown").to_string(),
            count("branch_jumps").to_string(),
            count("inverted").to_string(),
            format!("{:.2}", number("max_force_n")),
            format!("{:.1}", number("seconds")),
        ]);
    }

    pub(super) fn headline(&self) -> String {
        let Self { nodes, complete, solved, failed, branch_jumps, .. } = self;
        let state = if complete == nodes {
            "complete".into()
        } else {
            format!("{complete} of {nodes} nodes complete")
        };
        let nodes = if *nodes == 1 { "1 active node".into() } else { format!("{nodes} active nodes") };
        format!("{state}: {solved} configurations of {nodes}, {failed} failed, {branch_jumps} branch jumps")
    }

    /// The text of the command, with these lines about the whole file.
    pub(super) fn text(&self, head: &str) -> String {
        let Self { table, nodes, .. } = self;
        let more = nodes.saturating_sub(MAX_NODES);
        let more = if more > 0 { format!("\nand {more} more nodes") } else { String::new() };
        format!(
            "{}\n\n{head}\n{table}{more}\n\nfits, retries and held-out solutions: --verbose",
            self.headline()
        )
    }
}
