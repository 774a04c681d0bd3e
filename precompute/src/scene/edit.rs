//! A scene with one value changed, for a session that changes its model while a hand touches it.

use toml::{Table, Value};

use super::Scene;
use crate::error::InputError;

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
    fn what_the_scene_does_not_have_is_refused_in_one_line() {
        let error = text("material.kidney.c10_pa", "1.0").expect_err("no such group");
        assert!(error.contains("material.liver") && error.contains("material.tumour"), "{error}");
        let error = text("fixed.groop", "F2").expect_err("no such key");
        assert!(error.contains("groop") && error.contains("did you mean `group`?"), "{error}");
        assert!(text("name.x", "1").expect_err("a value").contains("is a value"));
    }
}
