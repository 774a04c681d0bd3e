//! Tests `palpate plan`: its table, its intervals for two bundled scenes against what happens, and the
//! comparison of a saved prediction. Seconds are printed, not asserted, because the machine may be shared.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::{palpate, refused, text};

fn succeeds(arguments: &[&str]) -> String {
    let output = palpate(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("text")
}

fn bundled(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/scenes").join(name)
}

/// A planned, solved and packed scene.
struct Solved {
    folder: tempfile::TempDir,
}

impl Solved {
    fn new(scene: &Path) -> Self {
        let solved = Self { folder: tempfile::tempdir().expect("a folder") };
        let [space, blob, plan] = ["a.space", "a.blob", "plan.json"].map(|name| solved.at(name));
        let said = succeeds(&["plan", text(scene), "--out", text(&plan)]);
        println!("{said}");
        assert!(said.contains("Recommended: ") && said.contains("Prediction as the scene asks"), "{said}");
        succeeds(&["precompute", text(scene), "--out", text(&space)]);
        succeeds(&["pack", text(&space), "--out", text(&blob), "--no-certificate"]);
        solved
    }

    fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The compared lines with a prediction of this content.
    fn check(&self, prediction: &Value) -> Vec<Value> {
        let path = self.at("edited.json");
        std::fs::write(&path, prediction.to_string()).expect("written");
        let [space, blob] = ["a.space", "a.blob"].map(|name| self.at(name));
        let words = ["plan", "--check", text(&space), "--prediction", text(&path), "--blob", text(&blob)];
        println!("{}", succeeds(&words));
        let figures: Value =
            serde_json::from_str(&succeeds(&[&words[..], &["--json"]].concat())).expect("JSON");
        figures["lines"].as_array().expect("lines").clone()
    }

    fn prediction(&self) -> Value {
        let text = std::fs::read_to_string(self.at("plan.json")).expect("saved");
        serde_json::from_str(&text).expect("JSON")
    }
}

/// The line of a quantity.
fn of<'l>(lines: &'l [Value], what: &str) -> &'l Value {
    lines.iter().find(|line| line["what"] == what).unwrap_or_else(|| panic!("no {what} in {lines:?}"))
}

#[test]
fn what_is_predicted_happens_and_the_check_follows_the_file() {
    let solved = Solved::new(&bundled("long-pull.toml"));
    let mut prediction = solved.prediction();
    let lines = solved.check(&prediction);
    for what in ["A2: solves tried", "A2: configurations kept", "blob"] {
        assert_eq!(of(&lines, what)["inside"], Value::Bool(true), "{}", of(&lines, what));
    }
    let tried = of(&lines, "A2: solves tried").clone();
    let [low, high] = ["low", "high"].map(|end| tried["predicted"][end].as_f64().expect("a number"));
    assert!(low < high, "{tried}");
    // The comparison is with the file: nothing is planned again.
    prediction["nodes"][0]["tried"]["low"] = 1.into();
    prediction["nodes"][0]["tried"]["likely"] = 2.into();
    prediction["nodes"][0]["tried"]["high"] = 3.into();
    let edited = solved.check(&prediction);
    let line = of(&edited, "A2: solves tried");
    assert_eq!((&line["predicted"]["high"], &line["inside"]), (&Value::from(3.0), &Value::Bool(false)));
    assert_eq!(line["happened"], tried["happened"]);
    assert_eq!(of(&edited, "A2: configurations kept"), of(&lines, "A2: configurations kept"));
}

#[test]
fn a_search_that_ends_within_the_probes_is_predicted_exactly() {
    // With linear elements the probes end the search in the time of a plan.
    let folder = tempfile::tempdir().expect("a folder");
    let scene = folder.path().join("light-touch.toml");
    let written = std::fs::read_to_string(bundled("light-touch.toml")).expect("a scene");
    let mesh = format!("file = {:?}", bundled("../liver-small.msh"));
    let linear = written.replace("order = 2\n", "").replace("file = \"../liver-small.msh\"", &mesh);
    assert!(linear.contains(&mesh) && linear.len() < written.len() + mesh.len());
    std::fs::write(&scene, linear).expect("written");
    let solved = Solved::new(&scene);
    let prediction = solved.prediction();
    let tried = &prediction["nodes"][0]["tried"];
    assert_eq!(tried["low"], tried["high"]);
    let lines = solved.check(&prediction);
    for what in ["A1: solves tried", "A1: configurations kept", "blob"] {
        assert_eq!(of(&lines, what)["inside"], Value::Bool(true), "{}", of(&lines, what));
    }
    refusals(&solved, prediction);
}

/// Predictions that cannot be compared with the space.
fn refusals(solved: &Solved, mut prediction: Value) {
    let [space, plan, other, missing] =
        ["a.space", "plan.json", "other.json", "missing.json"].map(|name| solved.at(name));
    prediction["key"] = "0123".into();
    prediction["scene"] = "somewhere".into();
    std::fs::write(&other, prediction.to_string()).expect("written");
    let check = ["plan", "--check", text(&space)];
    let with = |file: &Path| [&check[..], &["--prediction", text(file)]].concat().join("\n");
    let line = with(&other);
    let words: Vec<&str> = line.split('\n').collect();
    refused(&words, &["other.json", "another scene (somewhere)", "a.space", "palpate plan SCENE.toml --out"]);
    refused(&check, &["a.space", "needs the prediction", "palpate plan SCENE.toml --out FILE.json"]);
    std::fs::write(&other, "{\"F1\": [0, 1]}").expect("written");
    refused(&words, &["other.json", "not a saved prediction", "palpate plan SCENE.toml --out FILE.json"]);
    let line = with(&missing);
    refused(&line.split('\n').collect::<Vec<_>>(), &["missing.json"]);
    refused(&["plan", "--check", text(&missing), "--prediction", text(&plan)], &["missing.json"]);
    let output = palpate(&["plan", "--prediction", text(&plan)]);
    assert_eq!(output.status.code(), Some(2));
}
