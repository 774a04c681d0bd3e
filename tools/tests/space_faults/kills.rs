//! Fifty runs ended by SIGKILL. `tests/kills` runs it with other seeds.

use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use super::{Draws, dump, kept, precompute, scene, undisturbed};

/// `PALPATE_KILLS` gives another number, and `PALPATE_SEED` other moments.
const KILLS: u64 = 50;

/// 4,168 points: a second or more, in which a tenth of a second ends with a commit.
const FINE: &str = "radius_m = 0.01\nspacing_m = 0.00125";

/// When a run is killed.
#[derive(Clone, Copy)]
enum Moment {
    /// This time after its start.
    After(Duration),
    /// After this time, and after the rows that are committed by then have been read.
    Counted(Duration),
    /// When its log grows after about `skip` commits: during the write of a commit, if the kill is fast
    /// enough.
    Committing { skip: usize },
}

/// Whether the write-ahead log ends in an open transaction (sqlite.org/fileformat2.html, section 4): of the
/// frames with the current salt, the last one is not a commit.
fn log_is_torn(space: &Path) -> bool {
    let bytes = std::fs::read(format!("{}-wal", space.display())).unwrap_or_default();
    let mut torn = false;
    let Some((header, frames)) = bytes.split_at_checked(32) else { return torn };
    let page = u32::from_be_bytes([header[8], header[9], header[10], header[11]]) as usize;
    for frame in frames.chunks(24 + page) {
        if frame.get(8..16) != Some(&header[16..24]) {
            break;
        }
        torn = frame.len() < 24 + page || frame[4..8] == [0; 4];
    }
    torn
}

/// Waits for the moment and kills. Returns the rows that were read before; `None` if the run had already ended, which
/// must then be a success.
fn killed(mut run: Child, space: &Path, aside: &Path, moment: Moment) -> Option<Vec<String>> {
    let mut committed = Vec::new();
    match moment {
        // Time itself is the tested quantity here.
        Moment::After(wait) => std::thread::sleep(wait),
        Moment::Counted(wait) => {
            std::thread::sleep(wait);
            committed = kept(space, aside);
        }
        Moment::Committing { mut skip } => {
            let name = format!("{}-wal", space.display());
            let length = || std::fs::metadata(&name).map_or(0, |log| log.len());
            let mut before = length();
            while run.try_wait().expect("the state of a child").is_none() {
                let now = length();
                if now != before {
                    if skip == 0 {
                        break;
                    }
                    skip -= 1;
                    before = now;
                }
            }
        }
    }
    let ended = run.try_wait().expect("the state of a child");
    if let Some(status) = ended {
        assert!(status.success(), "{status}");
        return None;
    }
    run.kill().expect("SIGKILL");
    // The run may have ended between the two calls.
    (!run.wait().expect("reaped").success()).then_some(committed)
}

/// Every row of `before` is in the sorted `after`, unchanged, including its seconds.
fn assert_kept(before: &[String], after: &[String], kill: u64) {
    let lost: Vec<&String> = before.iter().filter(|row| after.binary_search(row).is_err()).collect();
    assert!(lost.is_empty(), "kill {kill} lost {} of {} rows: {:?}", lost.len(), before.len(), lost[0]);
}

#[test]
fn fifty_kills_lose_nothing_but_the_work_in_flight() {
    let folder = tempfile::tempdir().expect("a folder");
    let (scene, space) = (scene(folder.path(), FINE), folder.path().join("killed.space"));
    let began = Instant::now();
    let expected = undisturbed(&scene, folder.path());
    let whole_s = began.elapsed().as_secs_f64();
    let (wanted, mut draws) =
        (crate::number_of("PALPATE_KILLS", KILLS), Draws(crate::number_of("PALPATE_SEED", 4)));
    let (mut kills, mut at_start, mut solving, mut torn, mut ended, mut counted) = (0, 0, 0, 0, 0, 0);
    let mut before: Vec<String> = Vec::new();
    while kills < wanted {
        assert!(ended < wanted, "runs end before they are killed: {kills} kills");
        let moment = match draws.next() % 4 {
            0 => Moment::After(Duration::from_secs_f64(0.03 * draws.unit())),
            1 => Moment::Committing { skip: (draws.next() % 3) as usize },
            // Up to four tenths of a whole run: several kills per space.
            2 => Moment::After(Duration::from_secs_f64(0.4 * whole_s.min(2.0) * draws.unit())),
            _ => Moment::Counted(Duration::from_secs_f64(0.3 * whole_s.min(2.0) * draws.unit())),
        };
        let threads = 1 + (draws.next() % 3) as usize;
        let quiet = Stdio::null;
        let run = precompute(&scene, &space, threads).stdout(quiet()).stderr(quiet()).spawn().expect("runs");
        if let Some(committed) = killed(run, &space, folder.path(), moment) {
            kills += 1;
            torn += usize::from(log_is_torn(&space));
            let after = kept(&space, folder.path());
            assert_kept(&before, &after, kills);
            assert_kept(&committed, &after, kills);
            counted += usize::from(committed.len() > before.len());
            let gained = after.len() > before.len();
            *(if gained { &mut solving } else { &mut at_start }) += 1;
            before = after;
        } else {
            // The run ended before the kill: its space must be correct, and the remaining kills use a new
            // one.
            ended += 1;
            assert!(dump(&space, folder.path()) == expected, "after {kills} kills the space is another one");
            std::fs::remove_file(&space).expect("removed");
            before.clear();
        }
    }
    super::succeeds(precompute(&scene, &space, 2));
    assert!(dump(&space, folder.path()) == expected, "after {kills} kills the space is another one");
    println!(
        "{kills} kills of running processes: {at_start} before a row of theirs was kept, {solving} after, {torn} in the middle \
         of a commit, {counted} after new rows of theirs were read; {} spaces ended, all as the undisturbed one ({:.1} s; it took {whole_s:.1} s)",
        ended + 1,
        began.elapsed().as_secs_f64()
    );
    assert!(
        wanted < KILLS || at_start > 0 && solving > 5 && counted > 0,
        "{at_start} at start-up, {solving} later, {counted} with rows read before: the moments miss something"
    );
}
