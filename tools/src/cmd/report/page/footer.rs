//! Machine, versions, date and commands.

use super::super::results::Report;
use crate::plot::escaped;
use crate::words::{figure, percent, seconds};

/// Returns the footer.
pub(super) fn section(report: &Report) -> String {
    let m = &report.machine;
    let memory = m.memory_gb.map_or(String::new(), |gb| format!(", {} GB", figure(gb)));
    let others = match m.others_share {
        Some(share) if m.is_shared() => {
            format!("shared machine: other processes used {} of it", percent(share))
        }
        Some(share) => format!("other processes used {} of it", percent(share)),
        None => "unknown".into(),
    };
    let facts = [
        ("Command", format!("<code>{}</code>", escaped(&m.command))),
        ("Date", escaped(&m.date)),
        (
            "Machine",
            escaped(&format!(
                "{}, {} hardware threads{memory}; {} worker threads",
                m.cpu, m.cores, m.threads
            )),
        ),
        ("Load", escaped(&others)),
        ("System", escaped(&m.system)),
        ("Versions", escaped(&format!("palpate {}, solver {}, {}", m.palpate, m.solver, m.rustc))),
        (
            "This run",
            escaped(&format!(
                "{}; solutions of an earlier run are from {}, and their solve times are those of that run",
                seconds(m.wall_seconds),
                report.plan.work.path().display()
            )),
        ),
        (
            "Files",
            "<a href=\"certificates.json\">certificates.json</a>: the certificate of every blob; \
             <a href=\"machine.json\">machine.json</a>; <a href=\"left-out.json\">left-out.json</a>. \
             <code>palpate inspect</code> shows every .space and .blob in the work folder."
                .into(),
        ),
    ];
    let facts: String =
        facts.iter().map(|(name, text)| format!("<dt>{name}</dt><dd>{text}</dd>\n")).collect();
    format!("<footer>\n<dl>\n{facts}</dl>\n</footer>\n")
}
