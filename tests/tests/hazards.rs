//! Every name in the hazard table of docs/safety.md is that of an existing test, script or file.

use std::collections::BTreeSet;
use std::path::Path;

use palpate_tests::files;

#[test]
fn every_hazard_names_tests_that_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let safety = std::fs::read_to_string(root.join("docs/safety.md")).expect("the file is readable");
    let (_, table) = safety.split_once("## 5. Hazards").expect("the section of hazards");
    let (table, _) = table.split_once("## 6.").expect("the section after it");
    let all = files(&root);
    let sources = all.iter().filter(|path| path.extension().is_some_and(|extension| extension == "rs"));
    let mut tests = BTreeSet::new();
    for source in sources {
        let text = std::fs::read_to_string(source).expect("readable");
        let mut is_test = false;
        for line in text.lines().map(str::trim) {
            if let Some((name, _)) = line.strip_prefix("fn ").and_then(|rest| rest.split_once('(')) {
                if is_test {
                    tests.insert(name.to_string());
                }
                is_test = false;
            }
            is_test |= line == "#[test]";
            // Also inside `proptest!`.
            is_test &= !line.is_empty();
        }
    }
    let (mut rows, mut names) = (0, 0);
    for row in table.lines().filter(|line| line.starts_with("| ") && !line.starts_with("| hazard")) {
        rows += 1;
        let shown_by = row.trim_end_matches('|').rsplit_once('|').expect("three columns").1;
        let mut named = 0;
        for name in shown_by.split('`').skip(1).step_by(2) {
            named += 1;
            let is_file = all.iter().any(|path| {
                let path = path.to_string_lossy();
                path.ends_with(&format!("/{name}"))
                    || path.contains(&format!("/{}/", name.trim_end_matches('/')))
            });
            assert!(tests.contains(name) || is_file, "`{name}` is neither a test nor a file: {row}");
        }
        assert!(named > 0, "no test or file is named: {row}");
        names += named;
    }
    assert!(rows > 30 && names > 60, "{rows} hazards, {names} names: the table was not parsed");
}
