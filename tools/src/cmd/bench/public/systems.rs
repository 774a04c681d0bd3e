//! The columns of other systems.

use std::collections::BTreeMap;

use super::answers::{Answers, SYSTEM};
use super::figures::{Others, Section, Table};
use super::forces::judge_of;
use super::questions::Questions;
use crate::failure::Failure;

/// Name of the empty column.
pub(super) const YOURS: &str = "your system";

/// Adds a column for each system to every table that has one, or an empty one if there is no system.
pub(super) fn add_columns(
    sections: &mut [Section],
    questions: &[&Questions],
    systems: &[Answers],
) -> Result<(), Failure> {
    for system in systems {
        check(sections, system)?;
    }
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
    Ok(())
}

/// Refuses stated figures that no table has, or that are judged from forces.
fn check(sections: &[Section], system: &Answers) -> Result<(), Failure> {
    let tables: Vec<&Table> = sections.iter().flat_map(|section| &section.tables).collect();
    let wrong = |what: String| Err(Failure::input(format!("{}/{SYSTEM}: {what}", system.name)));
    for (key, rows) in &system.system.figures {
        let Some(table) = tables.iter().find(|table| table.key == *key) else {
            // The table may be one of a section that this run leaves out.
            let known = super::sections::KEYS.iter().any(|section| key.starts_with(&format!("{section}.")));
            if known {
                continue;
            }
            return wrong(format!("there is no table {key}; figures.csv has their names"));
        };
        match table.others {
            Others::Declared => {}
            Others::Judged => {
                return wrong(format!("{key} is judged from forces; answer its questions instead"));
            }
            Others::None => return wrong(format!("{key} has no column for other systems; remove it")),
        }
        if let Some(row) = rows.keys().find(|row| !table.rows.iter().any(|one| one.key == **row)) {
            return wrong(format!("the table {key} has no row {row}; figures.csv has their names"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cmd::bench::public::answers::{Forces, System};
    use crate::cmd::bench::public::figures::{Best, Row};
    use crate::cmd::bench::public::judge;
    use crate::cmd::bench::public::questions::Position;

    fn asked() -> Questions {
        let at = |x: f64| Position {
            displacement_m: [x, 0.0, 0.0],
            truth_n: [100.0 * x, 0.0, 0.0],
            residual_n: 0.0,
        };
        Questions { organ: "o".into(), positions: vec![at(0.01), at(0.02)], ..Questions::default() }
    }

    fn sections(asked: &Questions) -> Vec<Section> {
        let ours = Forces::of_field(asked, |d| Some(d.map(|x| 100.0 * x)));
        let judged = Table::judged("force.o", "", "", vec![("ours".into(), judge::positions(asked, &ours))]);
        let mut declared = Table::new("cost.o", "", "", "measure", vec!["ours".into()]);
        declared.others = Others::Declared;
        declared.rows.push(Row::new("bytes", "bytes", Best::Least, vec![10.0]));
        let section = |key: &str, table| Section {
            key: key.into(),
            title: String::new(),
            explains: vec![],
            repeats: vec![],
            quick: false,
            seconds: 0.0,
            tables: vec![table],
        };
        vec![section("force", judged), section("cost", declared)]
    }

    fn system(figures: &str, forces: Forces) -> Answers {
        let system: System = toml::from_str(figures).expect("TOML");
        Answers { name: "theirs".into(), system, forces: [("o".to_owned(), forces)].into() }
    }

    #[test]
    fn another_system_is_judged_as_ours_and_its_gaps_stay_empty() {
        let asked = asked();
        let mut sections = sections(&asked);
        // 10 % too stiff at the first position, no answer at the second.
        let mut forces = Forces::none(&asked);
        forces.positions[0] = Some([1.1, 0.0, 0.0]);
        add_columns(&mut sections, &[&asked], &[system("", forces)]).expect("known figures");
        let force = &sections[0].tables[0];
        assert!((force.value("max_mn", "theirs").expect("judged") - 100.0).abs() < 1e-9);
        assert_eq!(force.value("answered_percent", "theirs"), Some(50.0));
        assert_eq!(force.value("max_mn", "ours"), Some(0.0));
        assert_eq!(sections[1].tables[0].value("bytes", "theirs"), None, "not stated, so empty");
    }

    #[test]
    fn what_a_system_states_fills_its_cell_and_a_wrong_name_is_refused() {
        let asked = asked();
        let with = |figures: &str| {
            let mut sections = sections(&asked);
            let added = add_columns(&mut sections, &[&asked], &[system(figures, Forces::none(&asked))]);
            added.map(|()| sections[1].tables[0].value("bytes", "theirs")).map_err(|failure| failure.line())
        };
        assert_eq!(with("[figures.\"cost.o\"]\nbytes = 7"), Ok(Some(7.0)));
        assert_eq!(with("[figures.\"tick.controller\"]\nmax_us = 7"), Ok(None), "a section that is left out");
        for (figures, words) in [
            ("[figures.\"cost.o\"]\nbites = 7", "no row bites"),
            ("[figures.\"price.o\"]\nbytes = 7", "no table price.o"),
            ("[figures.\"force.o\"]\nmax_mn = 7", "judged from forces"),
        ] {
            let line = with(figures).expect_err(figures);
            assert!(line.contains(words), "{line}");
        }
    }

    #[test]
    fn without_a_system_an_empty_column_waits() {
        let asked = asked();
        let mut sections = sections(&asked);
        add_columns(&mut sections, &[], &[]).expect("nothing to refuse");
        for table in sections.iter().flat_map(|section| &section.tables) {
            assert_eq!(table.columns.last().map(String::as_str), Some(YOURS));
            assert!(table.rows.iter().all(|row| row.values.last() == Some(&None)));
        }
    }
}
