//! Other systems: their folders of answers, and their columns.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use palpate_core::Method;

use super::answers::{Forces, count};
use super::figures::{Others, Section};
use super::forces::{self, judge_of};
use super::questions::{HANDS, LOOPS, POSITIONS, Questions};
use super::scenes::ORGANS;
use super::stated::{SYSTEM, Stated, System};
use super::{cost, first_touch, nodule, ours, ticks, zwidth};
use crate::failure::Failure;

/// Name of the empty column.
pub(super) const YOURS: &str = "your system";

/// All that another system has answered.
#[derive(Debug)]
pub(super) struct Answers {
    /// Its name on the command line.
    pub(super) name: String,
    /// Its folder.
    folder: PathBuf,
    /// What it states.
    pub(super) system: System,
    /// Its forces for each organ; none before [`Answers::read_forces`].
    forces: BTreeMap<String, Forces>,
}

/// Opens the folders of the command line and refuses files that are not read, before anything is solved.
pub(super) fn open(answers: &[(String, PathBuf)]) -> Result<Vec<Answers>, Failure> {
    for (number, (name, folder)) in answers.iter().enumerate() {
        let refused = |why: &str| {
            let folder = folder.display();
            Err(Failure::input(format!("--answers {name}={folder}: {why}; choose another name")))
        };
        if own_columns().iter().any(|own| own.eq_ignore_ascii_case(name)) {
            return refused("this is the name of one of Palpate's columns");
        }
        if answers[..number].iter().any(|(other, _)| other.eq_ignore_ascii_case(name)) {
            return refused("this name is given twice");
        }
    }
    answers.iter().map(|(name, folder)| Answers::open(name, folder)).collect()
}

/// Names of the columns that another system cannot have.
fn own_columns() -> Vec<&'static str> {
    let methods = Method::ALL.iter().map(|method| method.name());
    let others = [ours::LIVE, nodule::COLUMN, YOURS];
    methods.chain(others).chain(first_touch::COLUMNS).chain(zwidth::COLUMNS).collect()
}

/// Keys of the rows that a system states in a table; `None` if it is no table for statements.
fn stated_rows(table: &str) -> Option<Vec<String>> {
    let keys = |keys: &[&str]| keys.iter().map(|key| (*key).to_owned()).collect();
    match table {
        zwidth::DAMPING => Some(zwidth::damping_rows()),
        zwidth::DEVICES => Some(zwidth::device_rows()),
        nodule::TABLE => Some(nodule::rows()),
        first_touch::TABLE => Some(first_touch::rows()),
        _ => {
            let (section, organ) = table.split_once('.')?;
            ORGANS.iter().find(|one| one.name == organ)?;
            match section {
                cost::KEY => Some(keys(&cost::ROWS.map(|(key, ..)| key))),
                ticks::KEY => Some(keys(&ticks::ROWS.map(|(key, ..)| key))),
                _ => None,
            }
        }
    }
}

/// Names of the tables for statements.
fn stated_tables() -> Vec<String> {
    let of_organs = |section: &str| ORGANS.iter().map(|organ| format!("{section}.{}", organ.name)).collect();
    let others =
        [zwidth::DAMPING, zwidth::DEVICES, nodule::TABLE, first_touch::TABLE].map(String::from).to_vec();
    [of_organs(cost::KEY), others, of_organs(ticks::KEY)].concat()
}

/// Why the figures cannot be stated.
fn wrong(figures: &Stated) -> Option<String> {
    for (table, rows) in figures {
        let Some(known) = stated_rows(table) else {
            let section = table.split_once('.').map_or("", |(section, _)| section);
            let is_judged = [forces::FORCE, forces::HANDS, forces::ENERGY].contains(&section);
            return Some(if is_judged {
                format!("{table} is judged from forces; answer its questions instead")
            } else {
                format!(
                    "there is no table {table} for statements; choose from {}",
                    stated_tables().join(", ")
                )
            });
        };
        if let Some(row) = rows.keys().find(|row| !known.contains(row)) {
            return Some(format!("the table {table} has no row {row}; choose from {}", known.join(", ")));
        }
    }
    None
}

/// Refuses folders and tables of another name in a folder of answers.
fn check_names(folder: &Path, folders: &[&str], files: &[&str]) -> Result<(), Failure> {
    let entries = std::fs::read_dir(folder).map_err(|error| Failure::file(folder, &error))?;
    let mut paths: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.sort_unstable();
    for path in paths {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let is_folder = path.is_dir();
        let is_table = path.extension().is_some_and(|kind| kind == "csv" || kind == "toml");
        let known = if is_folder { folders } else { files };
        // Notes and hidden files may be there.
        if name.starts_with('.') || known.contains(&&*name) || !(is_folder || is_table) {
            continue;
        }
        let (path, all) = (path.display(), [folders, files].concat().join(", "));
        return Err(Failure::input(format!(
            "{path}: this is not read; name it as one of {all}, or remove it"
        )));
    }
    Ok(())
}

impl Answers {
    /// Opens a folder with `system.toml` and a folder for each organ.
    fn open(name: &str, folder: &Path) -> Result<Self, Failure> {
        let refused = |why: &str| {
            Failure::input(format!(
                "--answers {name}={}: {why}; docs/formats.md describes its files",
                folder.display()
            ))
        };
        if !folder.is_dir() {
            return Err(refused("is no folder"));
        }
        check_names(folder, &ORGANS.map(|organ| organ.name), &[SYSTEM])?;
        let path = folder.join(SYSTEM);
        let system = System::read(&path)?;
        if let Some(why) = wrong(&system.figures) {
            return Err(Failure::input(format!("{}: {why}", path.display())));
        }
        let mut answered = system.figures.len();
        for folder in ORGANS.map(|organ| folder.join(organ.name)) {
            if folder.is_dir() {
                check_names(&folder, &[], &[POSITIONS, LOOPS, HANDS])?;
                answered += count(&folder)?;
            }
        }
        if answered == 0 {
            return Err(refused("has neither a force nor a figure"));
        }
        Ok(Self { name: name.into(), folder: folder.into(), system, forces: BTreeMap::new() })
    }

    /// Reads the forces at the questions.
    pub(super) fn read_forces(&mut self, questions: &[&Questions]) -> Result<(), Failure> {
        for of in questions {
            self.forces.insert(of.organ.clone(), Forces::read(of, &self.folder.join(&of.organ))?);
        }
        Ok(())
    }
}

/// Adds a column for each system to every table that has one, or an empty one if there is no system.
pub(super) fn add_columns(sections: &mut [Section], questions: &[&Questions], systems: &[Answers]) {
    for section in sections {
        let judge = judge_of(&section.key);
        for table in section.tables.iter_mut().filter(|table| table.others != Others::None) {
            if systems.is_empty() {
                table.add_column(YOURS, |_| None);
            }
            for system in systems {
                let stated = system.system.figures.get(&table.key);
                let judged: Option<BTreeMap<String, Option<f64>>> = judge.and_then(|judge| {
                    let organ = table.key.rsplit_once('.')?.1;
                    let asked = questions.iter().find(|questions| questions.organ == organ)?;
                    let figures = judge(asked, system.forces.get(organ)?);
                    Some(figures.into_iter().map(|figure| (figure.key, figure.value)).collect())
                });
                let is_judged = table.others == Others::Judged;
                table.add_column(&system.name, |row| {
                    if is_judged { judged.as_ref()?.get(row).copied()? } else { stated?.get(row).copied() }
                });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cmd::bench::public::figures::Table;
    use crate::cmd::bench::public::figures::{Best, Row};
    use crate::cmd::bench::public::judge;
    use crate::cmd::bench::public::questions::Position;

    fn asked() -> Questions {
        let at = |x: f64| Position {
            displacement_m: [x, 0.0, 0.0],
            truth_n: [100.0 * x, 0.0, 0.0],
            residual_n: 0.0,
        };
        Questions { organ: "point".into(), positions: vec![at(0.01), at(0.02)], ..Questions::default() }
    }

    fn sections(asked: &Questions) -> Vec<Section> {
        let ours = Forces::of_field(asked, |d| Some(d.map(|x| 100.0 * x)));
        let judged =
            Table::judged("force.point", "", "", vec![("ours".into(), judge::positions(asked, &ours))]);
        let mut declared = Table::new("cost.point", "", "", "measure", vec!["ours".into()]);
        declared.others = Others::Declared;
        declared.rows.push(Row::new("bytes", "bytes", Best::Least, vec![10.0]));
        let section =
            |key: &str, table| Section { key: key.into(), tables: vec![table], ..Section::default() };
        vec![section("force", judged), section("cost", declared)]
    }

    fn system(figures: &str, forces: Forces) -> Answers {
        let system = System::parse(figures).expect("figures");
        let forces = [("point".to_owned(), forces)].into();
        Answers { name: "theirs".into(), folder: PathBuf::new(), system, forces }
    }

    #[test]
    fn another_system_is_judged_as_ours_and_its_gaps_stay_empty() {
        let asked = asked();
        let mut sections = sections(&asked);
        // 10 % too stiff at the first position, no answer at the second.
        let mut forces = Forces::none(&asked);
        forces.positions[0] = Some([1.1, 0.0, 0.0]);
        add_columns(&mut sections, &[&asked], &[system("", forces)]);
        let force = &sections[0].tables[0];
        assert!((force.value("max_mn", "theirs").expect("judged") - 100.0).abs() < 1e-9);
        assert_eq!(force.value("answered_percent", "theirs"), Some(50.0));
        assert_eq!(force.value("max_mn", "ours"), Some(0.0));
        assert_eq!(sections[1].tables[0].value("bytes", "theirs"), None, "not stated, so empty");
    }

    #[test]
    fn what_a_system_states_fills_its_cell_and_a_wrong_name_is_refused() {
        let asked = asked();
        let mut sections = sections(&asked);
        let stated = system("[figures.\"cost.point\"]\nbytes = 7", Forces::none(&asked));
        add_columns(&mut sections, &[&asked], &[stated]);
        assert_eq!(sections[1].tables[0].value("bytes", "theirs"), Some(7.0));
        let refused = |figures: &str| wrong(&System::parse(figures).expect("figures").figures);
        for (figures, words) in [
            ("[figures.\"cost.point\"]\nbites = 7", "no row bites; choose from solves, solve_s, bytes"),
            ("[figures.\"price.point\"]\nbytes = 7", "no table price.point"),
            ("[figures.\"zwidth.wall\"]\n\"0.0\" = 7", "no table zwidth.wall for statements"),
            ("[figures.\"force.point\"]\nmax_mn = 7", "judged from forces"),
        ] {
            let line = refused(figures).expect(figures);
            assert!(line.contains(words), "{line}");
        }
        for table in stated_tables() {
            let row = stated_rows(&table).expect("rows").remove(0);
            assert_eq!(refused(&format!("[figures.\"{table}\"]\n{row} = 7")), None, "{table}, {row}");
        }
    }

    #[test]
    fn the_example_of_the_questions_can_be_stated() {
        let readme = super::super::scenes::readme(palpate_precompute::scene::PULP);
        assert!(readme.contains("k = 5e6 Pa/m, w = (1 - r^2/a^2)^2 for r < a"), "{readme}");
        let example = readme.split_once("about = ").and_then(|(_, rest)| rest.split_once("\n\n"));
        let (example, _) = example.expect("an example");
        let system = System::parse(&format!("about = {example}")).expect("figures");
        assert!(system.figures.len() == 2 && wrong(&system.figures).is_none(), "{system:?}");
    }

    /// The line with which a folder of these files is refused; `None` if it is opened.
    fn refusal(files: &[(&str, &str)]) -> Option<String> {
        let folder = tempfile::tempdir().expect("a folder");
        for (name, text) in files {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
            std::fs::write(path, text).expect("written");
        }
        Answers::open("theirs", folder.path()).err().map(|failure| failure.line())
    }

    #[test]
    fn a_folder_of_answers_that_is_not_read_is_refused() {
        let (row, empty) = ("position,fx_n,fy_n,fz_n\n0,1,2,3\n", "position,fx_n,fy_n,fz_n\n0,,,\n");
        let asked = "position,dx_m,dy_m,dz_m,hx_n,hy_n,hz_n,residual_n\n0,0,0,0,0,0,0,0\n";
        let cases: [(&[(&str, &str)], &str); 8] = [
            (&[], "neither a force nor a figure"),
            (&[("system.toml", "about = \"theirs\"")], "neither a force nor a figure"),
            (&[("point/positions.csv", empty)], "neither a force nor a figure"),
            (&[("Point/positions.csv", row)], "Point: this is not read; name it as one of point, fingertip"),
            (
                &[("point/position.csv", row)],
                "position.csv: this is not read; name it as one of positions.csv",
            ),
            (&[("positions.csv", row)], "positions.csv: this is not read"),
            (&[("point/positions.csv", asked)], "has no column fx_n"),
            (&[("point/loops.csv", "way,tick\n")], "has no column fx_n"),
        ];
        for (files, words) in cases {
            let line = refusal(files).unwrap_or_else(|| panic!("{files:?} is opened"));
            assert!(line.contains(words), "{line}");
        }
        let with_notes = [
            ("point/positions.csv", row),
            ("README.md", ""),
            ("point/.hidden.csv", ""),
            ("point/run.sh", ""),
        ];
        assert_eq!(refusal(&with_notes), None);
        assert_eq!(refusal(&[("system.toml", "[figures.\"cost.point\"]\nbytes = 7")]), None);
    }

    #[test]
    fn a_name_of_ours_and_a_repeated_one_are_refused() {
        let given = |names: &[&str]| {
            let answers: Vec<_> =
                names.iter().map(|name| ((*name).to_owned(), PathBuf::from("none"))).collect();
            open(&answers).expect_err("no folder").line()
        };
        for name in ["energy", "Live", "plain wall", "blob", "finite elements", YOURS] {
            assert!(given(&[name]).contains("one of Palpate's columns"), "{name}");
        }
        assert!(given(&["a", "A"]).contains("given twice"));
        assert!(given(&["a", "b"]).contains("is no folder"));
    }

    #[test]
    fn without_a_system_an_empty_column_waits() {
        let asked = asked();
        let mut sections = sections(&asked);
        add_columns(&mut sections, &[], &[]);
        for table in sections.iter().flat_map(|section| &section.tables) {
            assert_eq!(table.columns.last().map(String::as_str), Some(YOURS));
            assert!(table.rows.iter().all(|row| row.values.last() == Some(&None)));
        }
    }
}
