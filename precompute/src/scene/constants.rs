//! The constants of a scene's materials by name, and the scene with other values.

use std::ops::Range;
use std::path::Path;

use toml::Spanned;

use super::file::tables;
use super::{Scene, material};
use crate::error::InputError;
use crate::fem::body::Region;
use crate::fem::constant::BULK;
use crate::fem::material::Value;

/// A number that the scene states for a material.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneConstant {
    /// The key, with the group of the material before it if there are several: `c10_pa`, `tumour.c10_pa`.
    pub name: String,
    /// Index of the material.
    pub region: usize,
    /// The key in the table of the material.
    pub key: &'static str,
    /// The stated value, in the unit at the end of the key.
    pub value: f64,
    span: Range<usize>,
}

impl Scene {
    /// The numbers of all materials, in the order of the file.
    pub fn constants(&self) -> Vec<SceneConstant> {
        let tables = tables(&self.file.material);
        let mut constants = Vec::new();
        for (region, table) in tables.iter().map(|located| located.table).enumerate() {
            let number = |value: &Spanned<Value>| match *value.get_ref() {
                Value::Number(number) => Some((number, value.span())),
                Value::Vector(_) => None,
            };
            let of_law = table.parameters.iter().filter_map(|(key, value)| Some((*key, number(value)?)));
            let bulk = table.bulk_pa.iter().map(|value| (BULK, (*value.get_ref(), value.span())));
            let mut stated: Vec<_> = of_law.chain(bulk).collect();
            stated.sort_by_key(|(_, (_, span))| span.start);
            for (key, (value, span)) in stated {
                let group = table.group.as_ref().filter(|_| tables.len() > 1);
                let name = group.map_or_else(|| key.into(), |group| format!("{}.{key}", group.get_ref()));
                constants.push(SceneConstant { name, region, key, value, span });
            }
        }
        constants
    }

    /// The scene with other values of some constants, in the same text with its comments.
    ///
    /// # Errors
    ///
    /// [`InputError`] if the law of a material refuses the values.
    pub fn with_constants(&self, values: &[(&SceneConstant, f64)]) -> Result<Self, InputError> {
        let replaced = values.iter().map(|(constant, value)| (constant.span.clone(), format!("{value:?}")));
        let scene = Self::parse(&self.place.path, self.replaced(replaced.collect()))?;
        scene.laws()?;
        Ok(scene)
    }

    /// The materials without their tets.
    pub(crate) fn laws(&self) -> Result<Vec<Region>, InputError> {
        let law = |table| {
            let (material, bulk_modulus_pa) = material::law(&self.place, table, &mut Vec::new())?;
            Ok(Region { material, bulk_modulus_pa })
        };
        tables(&self.file.material).iter().map(law).collect()
    }

    /// Text of the scene.
    pub fn text(&self) -> &str {
        &self.place.text
    }

    /// Path of the scene file.
    pub fn path(&self) -> &Path {
        &self.place.path
    }

    /// Text of the scene, for a file in `folder`: in another folder than that of the scene, the files that it names
    /// have absolute paths.
    ///
    /// # Errors
    ///
    /// The operating system's error if a folder or file is not there.
    pub fn text_for(&self, folder: &Path) -> std::io::Result<String> {
        let here = |folder: &Path| folder.join(".").canonicalize();
        let own = self.place.path.parent().unwrap_or(Path::new(""));
        if here(own)? == here(folder)? {
            return Ok(self.place.text.clone());
        }
        let named = [
            Some(&self.file.mesh.get_ref().file),
            self.file.fixed.get_ref().file.as_ref(),
            self.file.device.as_ref().and_then(|device| device.get_ref().profile.as_ref()),
        ];
        let is_file = |name: &&Spanned<String>| self.place.relative(name.get_ref()).is_file();
        let absolute = |name: &Spanned<String>| {
            let path = self.place.relative(name.get_ref()).canonicalize()?;
            Ok((name.span(), toml::Value::String(path.to_string_lossy().into_owned()).to_string()))
        };
        let paths: std::io::Result<_> = named.into_iter().flatten().filter(is_file).map(absolute).collect();
        Ok(self.replaced(paths?))
    }

    /// The text with other words at some places.
    fn replaced(&self, mut words: Vec<(Range<usize>, String)>) -> String {
        words.sort_by_key(|(span, _)| std::cmp::Reverse(span.start));
        let mut text = self.place.text.clone();
        for (span, word) in words {
            text.replace_range(span, &word);
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCENE: &str = "[mesh]\nfile = \"two.msh\"\n[[material]]\ngroup = \"liver\"\nlaw = \"mooney-rivlin\"\n\
        c10_pa = 1300.0 # of the paper\nc01_pa = 1280\nbulk_pa = 1e6\n[[material]]\ngroup = \"tumour\"\nlaw = \"neo-hookean\"\n\
        young_pa = 9e4\npoisson = 0.45\n[fixed]\ngroup = \"F1\"\n[[active]]\nnode = 3\n";

    fn scene(text: &str) -> Scene {
        Scene::parse(Path::new("two.toml"), text.into()).expect("a scene")
    }

    #[test]
    fn constants_have_the_name_of_their_group_and_keep_their_comments() {
        let scene = scene(SCENE);
        let constants = scene.constants();
        let names: Vec<&str> = constants.iter().map(|constant| constant.name.as_str()).collect();
        assert_eq!(
            names,
            ["liver.c10_pa", "liver.c01_pa", "liver.bulk_pa", "tumour.young_pa", "tumour.poisson"]
        );
        let other = scene.with_constants(&[(&constants[1], 900.5), (&constants[3], 8e4)]).expect("accepted");
        assert_eq!(
            other.place.text,
            SCENE.replace("c01_pa = 1280", "c01_pa = 900.5").replace("9e4", "80000.0")
        );
        assert_eq!(other.constants()[3].value, 8e4);
        let error = scene.with_constants(&[(&constants[4], 0.5)]).expect_err("refused");
        assert!(error.to_string().contains("two.toml:13: `poisson` = 0.5 must be"), "{error}");
    }

    #[test]
    fn one_material_has_plain_names() {
        let one = SCENE.replace("[[material]]\ngroup = \"liver\"", "[material]").replace(
            "[[material]]\ngroup = \"tumour\"\nlaw = \"neo-hookean\"\nyoung_pa = 9e4\npoisson = 0.45\n",
            "",
        );
        let names: Vec<String> = scene(&one).constants().into_iter().map(|constant| constant.name).collect();
        assert_eq!(names, ["c10_pa", "c01_pa", "bulk_pa"]);
    }
}
