//! What the parts of a scene look up while it is resolved.

use std::collections::BTreeMap;

use toml::Spanned;

use super::place::Place;
use crate::error::{InputError, nearest_word};
use crate::mesh::{Surface, TetMesh};

/// The scene's text, its mesh and the warnings so far.
pub(super) struct Lookup<'a> {
    pub(super) place: &'a Place,
    pub(super) mesh: &'a TetMesh,
    pub(super) skin: &'a Surface,
    /// The surface without the walls of cavities.
    pub(super) seen: &'a Surface,
    /// Whether the mesh comes from the file that the scene names; otherwise that is not read.
    pub(super) has_file: bool,
    pub(super) warnings: Vec<String>,
}

impl Lookup<'_> {
    /// Members of a named group; an error lists the existing groups.
    pub(super) fn group<'g>(
        &self,
        groups: &'g BTreeMap<String, Vec<u32>>,
        of: &str,
        name: &Spanned<String>,
    ) -> Result<&'g [u32], InputError> {
        if let Some(members) = groups.get(name.get_ref()) {
            return Ok(members);
        }
        let known: Vec<&str> = groups.keys().map(String::as_str).collect();
        let fix = match nearest_word(name.get_ref(), known.iter().copied()) {
            _ if known.is_empty() => "the mesh has none: add a physical group in the mesh generator".into(),
            Some(guess) => format!("did you mean \"{guess}\"? (groups: {})", known.join(", ")),
            None => format!("use one of: {}", known.join(", ")),
        };
        let what = format!("the mesh has no group of {of} named \"{}\"", name.get_ref());
        Err(self.place.error(name.span(), what, fix))
    }
}
