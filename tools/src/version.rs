//! The answer to `palpate --version`. `-V` prints the first line only.

use std::sync::LazyLock;

use palpate_precompute::space::solver_version;

/// Features of the crate `palpate`, and whether each is enabled.
const FEATURES: [(&str, bool); 2] = [("mpi", cfg!(feature = "mpi")), ("peers", cfg!(feature = "peers"))];

/// Version, commit if the build knew it, target, compiler, features, and the version of the solver's numbers, which
/// a `.space` must have.
pub(crate) fn long() -> &'static str {
    static TEXT: LazyLock<String> = LazyLock::new(|| text(env!("PALPATE_COMMIT"), &FEATURES));
    &TEXT
}

fn text(commit: &str, features: &[(&str, bool)]) -> String {
    let names = |enabled: bool| -> String {
        let names: Vec<&str> =
            features.iter().filter(|(_, is)| *is == enabled).map(|(name, _)| *name).collect();
        if names.is_empty() { "none".into() } else { names.join(", ") }
    };
    let mut lines = vec![env!("CARGO_PKG_VERSION").to_owned()];
    if !commit.is_empty() {
        lines.push(format!("commit    {commit}"));
    }
    lines.push(format!("target    {}", env!("PALPATE_TARGET")));
    lines.push(format!("compiler  {}", env!("PALPATE_RUSTC")));
    lines.push(format!("features  {} (not built in: {})", names(true), names(false)));
    lines.push(format!("solver    {}", solver_version()));
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn features_are_named_on_either_side_and_an_unknown_commit_has_no_line() {
        let built = text("65e7dba5", &[("mpi", true), ("peers", false)]);
        assert!(built.contains("\ncommit    65e7dba5\n"), "{built}");
        assert!(built.contains("\nfeatures  mpi (not built in: peers)\n"), "{built}");
        let bare = text("", &[("mpi", false), ("peers", false)]);
        assert!(
            !bare.contains("commit") && bare.contains("features  none (not built in: mpi, peers)"),
            "{bare}"
        );
        assert!(bare.ends_with(&solver_version()), "{bare}");
    }
}
