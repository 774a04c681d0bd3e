//! Scenes made from a scene: with one value changed, for a session that changes its model while a hand touches
//! it; and with the contacts that a hand has visited, to solve them to the end.

use toml::{Table, Value};

use super::Scene;
use crate::error::InputError;

/// A contact that a hand has visited.
#[derive(Debug, Clone, PartialEq)]
pub struct VisitedContact {
    /// Name of its space.
    pub name: String,
    /// The mesh node of a point tool, or the position on the undeformed skin of a tool with a size, m.
    pub place: VisitedPlace,
    /// Displacements of the tool, m.
    pub visited_m: Vec<[f64; 3]>,
}

/// Where a visited contact is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum VisitedPlace {
    /// A node.
    Node(u32),
    /// A point of the skin.
    Point([f64; 3]),
}

impl Scene {
    /// The scene with one value changed, as if it stood in the file.
    ///
    /// `key` is the path of the value with dots between its parts: `fixed.group`, or `material.tumour.c10_pa` for
    /// the table of an array that has this `group` or `name`. `value` is written as in TOML; a word without quotes
    /// is a string.
    ///
    /// # Errors
    ///
    /// [`InputError`] if there is no such table, or if the scene refuses the value.
    pub fn with(&self, key: &str, value: &str) -> Result<Self, InputError> {
        let refused = |what: String, fix: String| InputError::new(&self.place.path, what, fix);
        let mut table: Table = self.place.text.parse().expect("the text was parsed before");
        let (path, last) = key.rsplit_once('.').unwrap_or(("", key));
        let here = table_at(&mut table, path)
            .map_err(|fix| refused(format!("`{key}` is in no table of the scene"), fix))?;
        let parsed = format!("value = {value}").parse::<Table>().ok().and_then(|mut one| one.remove("value"));
        here.insert(last.to_owned(), parsed.unwrap_or_else(|| Value::String(value.to_owned())));
        let text = toml::to_string(&table)
            .map_err(|error| refused(format!("`{key} = {value}`: {error}"), "use a plain value".into()))?;
        Self::parse(&self.place.path, text)
    }

    /// The scene with these contacts as its active nodes. Adaptive sampling solves the visited displacements first;
    /// a lattice becomes a sampling of what cannot be felt, within `radius_m`.
    ///
    /// # Errors
    ///
    /// [`InputError`] if the scene refuses them, for example without the force limit of a device.
    pub fn with_visits(&self, contacts: &[VisitedContact], radius_m: f64) -> Result<Self, InputError> {
        let numbers = |at_m: &[f64; 3]| Value::Array(at_m.iter().map(|&x| Value::Float(x)).collect());
        let active = contacts.iter().map(|contact| {
            let place = match &contact.place {
                VisitedPlace::Node(node) => ("node", Value::Integer(i64::from(*node))),
                VisitedPlace::Point(at_m) => ("point", numbers(at_m)),
            };
            let visited = Value::Array(contact.visited_m.iter().map(numbers).collect());
            let keys = [("name", Value::String(contact.name.clone())), place, ("visited_m", visited)];
            Value::Table(keys.into_iter().map(|(key, value)| (key.to_owned(), value)).collect())
        });
        let mut table: Table = self.place.text.parse().expect("the text was parsed before");
        table.insert("active".to_owned(), Value::Array(active.collect()));
        let grid = table.entry("grid").or_insert_with(|| Value::Table(Table::new()));
        let grid = grid.as_table_mut().expect("the scene was parsed before");
        for lattice in ["spacing_m", "points", "increments", "complete_cells"] {
            grid.remove(lattice);
        }
        if !["tolerance_n", "tolerance_relative", "cannot_be_felt"].iter().any(|key| grid.contains_key(*key))
        {
            grid.insert("cannot_be_felt".to_owned(), Value::Boolean(true));
        }
        grid.insert("radius_m".to_owned(), Value::Float(radius_m));
        let text = toml::to_string(&table).expect("a table of plain values");
        Self::parse(&self.place.path, text)
    }
}

/// The table at a path; an absent one is made. The error is what to use instead.
fn table_at<'t>(root: &'t mut Table, path: &str) -> Result<&'t mut Table, String> {
    let mut here = root;
    let mut parts = path.split('.').filter(|part| !part.is_empty());
    while let Some(part) = parts.next() {
        here = match here.entry(part).or_insert_with(|| Value::Table(Table::new())) {
            Value::Table(inner) => inner,
            Value::Array(tables) => {
                let of = |table: &Value| {
                    let word = |key: &str| table.get(key).and_then(Value::as_str).map(str::to_owned);
                    word("group").or_else(|| word("name")).unwrap_or_default()
                };
                let names: Vec<String> = tables.iter().map(of).collect();
                let wanted = parts.next().unwrap_or_default();
                let index = names.iter().position(|name| name == wanted);
                let all = names.iter().map(|name| format!("`{part}.{name}`")).collect::<Vec<_>>().join(", ");
                index
                    .and_then(|index| tables.get_mut(index).and_then(Value::as_table_mut))
                    .ok_or_else(|| format!("use one of {all}"))?
            }
            _ => return Err(format!("`{part}` is a value and no table")),
        };
    }
    Ok(here)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    const SCENE: &str = "name = \"two\"\n[mesh]\nfile = \"two.msh\"\n[[material]]\ngroup = \"liver\"\nlaw = \"mooney-rivlin\"\n\
        c10_pa = 1300.0\nc01_pa = 1280.0\n[[material]]\ngroup = \"tumour\"\nlaw = \"mooney-rivlin\"\nc10_pa = 9000.0\nc01_pa = 100.0\n\
        [fixed]\ngroup = \"F1\"\n[[active]]\nname = \"A1\"\nnode = 3\n";

    fn text(key: &str, value: &str) -> Result<String, String> {
        let scene = Scene::parse(Path::new("two.toml"), SCENE.into()).expect("a scene");
        scene.with(key, value).map(|scene| scene.place.text).map_err(|error| error.to_string())
    }

    #[test]
    fn a_value_is_changed_where_it_stands() {
        let softer = text("material.tumour.c10_pa", "4500.0").expect("a material");
        assert!(softer.contains("c10_pa = 4500.0") && softer.contains("c10_pa = 1300.0"), "{softer}");
        assert!(!softer.contains("9000"), "{softer}");
        assert!(text("fixed.group", "F2").expect("a group").contains("group = \"F2\""));
        let heavy = text("body_force.gravity_m_s2", "[0.0, -9.81, 0.0]");
        // A new table; the scene then asks for the density.
        assert!(
            heavy.clone().is_ok_and(|t| t.contains("-9.81")) || heavy.is_err_and(|e| e.contains("density"))
        );
    }

    #[test]
    fn visited_contacts_become_the_active_nodes() {
        let scene =
            Scene::parse(Path::new("two.toml"), format!("{SCENE}[grid]\nradius_m = 0.02\npoints = 514\n"));
        let contact = |name: &str, place, x: f64| VisitedContact {
            name: name.into(),
            place,
            visited_m: vec![[x, 0.0, -1e-3]],
        };
        let visited = [
            contact("A1", VisitedPlace::Node(3), 0.01),
            contact("P", VisitedPlace::Point([0.1, 0.2, 0.3]), 0.03),
        ];
        let text = scene.expect("a scene").with_visits(&visited, 0.035).expect("accepted").place.text;
        for words in [
            "node = 3",
            "point = [0.1, 0.2, 0.3]",
            "visited_m = [[0.01, 0.0, -0.001]]",
            "cannot_be_felt = true",
        ] {
            assert!(text.contains(words), "{words}: {text}");
        }
        assert!(!text.contains("514") && text.contains("radius_m = 0.035"), "{text}");
    }

    #[test]
    fn what_the_scene_does_not_have_is_refused_in_one_line() {
        let error = text("material.kidney.c10_pa", "1.0").expect_err("no such group");
        assert!(error.contains("material.liver") && error.contains("material.tumour"), "{error}");
        let error = text("fixed.groop", "F2").expect_err("no such key");
        assert!(error.contains("groop") && error.contains("did you mean `group`?"), "{error}");
        assert!(text("name.x", "1").expect_err("a value").contains("is a value"));
    }
}
