//! Circles between the files of a crate: files that import one another, directly or through others.
//!
//! An import of a name that a facade declares (`pub use`) counts as an import of the file that the facade
//! names. A module and its own submodules may import one another: they are one module in several files.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::strata::{Contents, ModulePath, walk};

/// The groups of files of a crate that import one another, each as sorted module paths.
///
/// `src` is the folder of `lib.rs`. Items under `#[cfg(test)]` are skipped.
///
/// # Panics
///
/// If a file of the crate cannot be read or parsed.
#[must_use]
pub fn circles(src: &Path) -> Vec<Vec<String>> {
    let contents = walk(src, &[]);
    let mut graph: BTreeMap<ModulePath, BTreeSet<ModulePath>> = BTreeMap::new();
    for (from, target) in &contents.imports {
        let (from, to) = (file_of(&contents, from), file_of(&contents, &resolved(&contents, target)));
        if !from.starts_with(&to) && !to.starts_with(&from) {
            graph.entry(from).or_default().insert(to);
        }
    }
    let reach: BTreeMap<&ModulePath, BTreeSet<&ModulePath>> =
        graph.keys().map(|from| (from, reachable(&graph, from))).collect();
    let in_circle = |from: &ModulePath| -> Vec<String> {
        let back = |to: &&&ModulePath| reach.get(**to).is_some_and(|reached| reached.contains(from));
        reach[from].iter().filter(back).map(|path| path.join("::")).collect()
    };
    let found: BTreeSet<Vec<String>> =
        graph.keys().map(in_circle).filter(|circle| circle.len() > 1).collect();
    found.into_iter().collect()
}

/// The files that `from` imports, directly or through others.
fn reachable<'g>(
    graph: &'g BTreeMap<ModulePath, BTreeSet<ModulePath>>,
    from: &ModulePath,
) -> BTreeSet<&'g ModulePath> {
    let (mut reached, mut open) = (BTreeSet::new(), vec![from]);
    while let Some(path) = open.pop() {
        for next in graph.get(path).into_iter().flatten() {
            if reached.insert(next) {
                open.push(next);
            }
        }
    }
    reached
}

/// The module of the file that contains a module or an item.
fn file_of(contents: &Contents, path: &[String]) -> ModulePath {
    let files = contents.files.iter().filter(|file| path.starts_with(file));
    files.max_by_key(|file| file.len()).cloned().unwrap_or_default()
}

/// The path of an item after all names that a `use` declares are replaced by what they name.
fn resolved(contents: &Contents, path: &[String]) -> ModulePath {
    let mut path = path.to_vec();
    // A chain of facades is short; the limit ends a chain that names itself.
    for _ in 0..16 {
        let replacement = contents.names.iter().find_map(|(module, name, target)| {
            let (own, rest) = path.split_at_checked(module.len())?;
            let (first, rest) = rest.split_first()?;
            // A module and a function may have the same name; a path goes on after a module.
            let is_module = !rest.is_empty()
                && contents.files.iter().any(|file| path.starts_with(file) && file.len() > own.len());
            let is_named = own == module && first == name && !path.starts_with(target) && !is_module;
            is_named.then(|| [target, rest].concat())
        });
        match replacement {
            Some(replacement) => path = replacement,
            None => break,
        }
    }
    path
}
