//! Tests `run --record`, `--device replay:` and `inspect FILE.mcap` as a user types them.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use palpate_core::{Coverage, Fault, Phase};
use palpate_host::TickRecord;
use palpate_record::{Recording, TickWriter};

use crate::{palpate, refused, text};

/// A real organ with every method, without a certificate.
const BLOB: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../firmware-like-core/golden/organ-514.blob");

/// Exit code and the text on both streams.
fn said(arguments: &[&str]) -> (Option<i32>, String) {
    let output = palpate(arguments);
    let text = [output.stdout, output.stderr].concat();
    (output.status.code(), String::from_utf8_lossy(&text).into_owned())
}

fn figures(recording: &Path) -> serde_json::Value {
    let output = palpate(&["inspect", text(recording), "--json"]);
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// The recording with every record changed.
fn rewritten(from: &Path, to: &Path, mut change: impl FnMut(&mut TickRecord)) {
    let source = BufReader::new(File::open(from).expect("it is there"));
    let recording = Recording::open(source).expect("sound");
    let mut writer =
        TickWriter::new(File::create(to).expect("writable"), recording.header()).expect("writable");
    for record in recording {
        let mut record = record.expect("sound");
        change(&mut record);
        writer.write(&record).expect("writable");
    }
    writer.finish(None).expect("writable");
}

#[test]
fn a_session_is_recorded_inspected_and_replayed() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let (recording, frames, csv) = (at("session.mcap"), at("frames"), at("ticks.csv"));
    let replay_of = |path: &Path| format!("replay:{}", text(path));
    let shown = ["--headless", "--pictures", text(&frames)];
    let record =
        ["run", BLOB, "--uncertified", "--method", "hermite", "--seconds", "2", "--record", text(&recording)];
    let (code, told) = said(&[&record[..], &shown].concat());
    assert_eq!(code, Some(0), "{told}");
    assert!(told.contains("session.mcap: ") && told.contains(", 0 more dropped"), "{told}");
    let (code, told) = said(&[&record[..], &shown].concat());
    assert_eq!(code, Some(2), "a recording is never overwritten: {told}");
    assert!(told.contains("session.mcap"), "{told}");

    let output = palpate(&["inspect", text(&recording), "--json", "--csv", text(&csv)]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let figures: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let ticks = figures["ticks"].as_u64().expect("a number");
    // A tick whose deadline passes at the end of the session is neither recorded nor skipped.
    let late = (figures["max_lateness_us"].as_f64().expect("a number") * 1e-3).ceil() as u64;
    let periods = ticks + figures["skipped_periods"].as_u64().expect("a number");
    assert!(periods <= 2_000 && 2_000 - periods <= late, "{figures}");
    assert_eq!((&figures["method"], &figures["end"]), (&"hermite".into(), &"completed".into()));
    assert_eq!((&figures["lost"], &figures["cut"]), (&0.into(), &false.into()));
    let (code, told) = said(&["inspect", text(&recording)]);
    assert!(code == Some(0) && told.contains("simulated hand") && told.contains("peak force"), "{told}");

    // Full precision: the table holds the recorded numbers, to the bit.
    let table = std::fs::read_to_string(&csv).expect("the table");
    let mut lines = table.lines();
    let names: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let column = |name: &str| names.iter().position(|n| *n == name).unwrap_or_else(|| panic!("no {name}"));
    let records = Recording::open(BufReader::new(File::open(&recording).expect("there"))).expect("sound");
    let mut rows = 0;
    for (record, line) in records.map(|record| record.expect("sound")).zip(lines) {
        let cells: Vec<&str> = line.split(',').collect();
        let vector = |names: [&str; 3]| names.map(|n| cells[column(n)].parse::<f32>().expect("a number"));
        assert_eq!(vector(["x_m", "y_m", "z_m"]), record.displacement_m);
        assert_eq!(vector(["fx_n", "fy_n", "fz_n"]), record.reaction_n);
        assert_eq!(vector(["hand_fx_n", "hand_fy_n", "hand_fz_n"]), record.hand_force_n);
        assert_eq!(cells[column("tick")], record.tick.to_string());
        rows += 1;
    }
    assert_eq!(rows, ticks);

    let (code, told) = said(&[&["run", BLOB, "--device", &replay_of(&recording)], &shown[..]].concat());
    assert_eq!(code, Some(0), "{told}");
    assert!(told.contains(&format!("{ticks} ticks, all forces bit-identical")), "{told}");
    assert!(std::fs::read_dir(&frames).expect("frames").count() >= 4, "frames of the replay");

    let planted = at("planted.mcap");
    // A force that was not applied.
    rewritten(&recording, &planted, |record| record.hand_force_n[1] += 1.0);
    let (code, told) = said(&[&["run", BLOB, "--device", &replay_of(&planted)], &shown[..]].concat());
    assert!(
        code == Some(1) && told.contains("the first is tick ") && told.contains("planted.mcap"),
        "{told}"
    );
    // Another method is a comparison, not a failure.
    let other = ["run", BLOB, "--device", &replay_of(&recording), "--method", "trilinear"];
    let (code, told) = said(&[&other[..], &shown].concat());
    assert_eq!(code, Some(0), "{told}");

    // A recording truncated by a killed session.
    let cut = at("cut.mcap");
    let bytes = std::fs::read(&recording).expect("there");
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).expect("writable");
    let (code, told) = said(&["inspect", text(&cut)]);
    assert!(code == Some(0) && told.contains("truncated: the file ends"), "{told}");
    let (code, told) = said(&[&["run", BLOB, "--device", &replay_of(&cut)], &shown[..]].concat());
    assert!(
        code == Some(0) && told.contains("bit-identical") && told.contains("is truncated here"),
        "{told}"
    );
}

/// A peak of one tick, a time without data and a fault are in the picture of the recording, and in that of their time.
#[test]
fn a_recording_is_drawn_over_time() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let (recording, planted, picture) = (at("session.mcap"), at("planted.mcap"), at("session.svg"));
    let run = ["run", BLOB, "--uncertified", "--headless", "--frame-rate", "0", "--seconds", "2", "--record"];
    let (code, told) = said(&[&run[..], &[text(&recording)]].concat());
    assert_eq!(code, Some(0), "{told}");
    rewritten(&recording, &planted, |record| match record.t_us / 1000 {
        // The peak that a picture of every second tick would miss, whether even or odd.
        700 => record.hand_force_n = [0.0, 321.0, 0.0],
        1000..1100 => record.coverage = Some(Coverage::Extrapolated),
        1500.. => record.phase = Phase::SafeZero(Fault::Overspeed),
        _ => {}
    });
    let drawing = |window: &[&str]| {
        let (code, told) =
            said(&[&["inspect", text(&planted), "--picture", text(&picture)], window].concat());
        assert_eq!(code, Some(0), "{told}");
        std::fs::read_to_string(&picture).expect("the picture")
    };
    let (all, before, peak) =
        (drawing(&[]), drawing(&["--window", "0,0.6"]), drawing(&["--window", "0.65,0.75"]));
    for (drawn, has_peak, has_fault) in [(&all, true, true), (&before, false, false), (&peak, true, false)] {
        assert!(drawn.starts_with("<svg xmlns=") && drawn.ends_with("</svg>\n"), "{drawn}");
        assert_eq!(drawn.contains(">300</text>"), has_peak, "the axis of a force of 321 N");
        assert_eq!(drawn.contains(">overspeed</text>"), has_fault);
    }
    assert!(all.contains("speed of the tool") && all.matches(">magnitude<").count() == 2, "{all}");

    let refusals: [(&[&str], &str); 5] = [
        (&["--window", "9,10"], "give a --window before its end"),
        (&["--window", "2,1"], "the earlier one first"),
        (&["--window=-1,1"], "the earlier one first"),
        (&["--window", "x"], "the earlier one first"),
        (&["--from", "front"], "--from"),
    ];
    for (arguments, reason) in refusals {
        let (code, told) =
            said(&[&["inspect", text(&planted), "--picture", text(&picture)], arguments].concat());
        assert!(code == Some(2) && told.contains(reason), "{arguments:?}: {told}");
    }
    let (code, told) = said(&["inspect", BLOB, "--picture", text(&picture)]);
    assert!(code == Some(2) && told.contains("--picture for .space and .mcap"), "{told}");
}

/// Standard output is one JSON object for any other options, and the exit codes are the same.
#[test]
fn a_session_and_its_replay_as_json() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let (recording, csv) = (at("session.mcap"), at("timing.csv"));
    let object = |arguments: &[&str]| -> serde_json::Value {
        let quiet = ["--uncertified", "--headless", "--frame-rate", "0", "--json"];
        let output = palpate(&[&["run", BLOB], arguments, &quiet].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).expect("one object, and nothing after it")
    };
    let figures = object(&[
        "--seconds",
        "1.5",
        "--fifo",
        "0",
        "--profile",
        "falcon",
        "--histograms",
        text(&csv),
        "--record",
        text(&recording),
    ]);
    let session = &figures["session"];
    let (ticks, latency) = (session["ticks"].as_u64().expect("a number"), &session["latency"]);
    assert_eq!(ticks + latency["missed_deadlines"].as_u64().expect("a number"), 1_500, "{figures}");
    for quantity in ["lateness_ns", "device_ns", "compute_ns"] {
        let of = |name: &str| latency[quantity][name].as_u64().expect("a number");
        assert!(of("count") == ticks && of("p50") <= of("p99") && of("p99") <= of("max"), "{figures}");
    }
    assert_eq!((&session["end"], &session["fault"]), (&"completed".into(), &serde_json::Value::Null));
    assert_eq!(&session["phase"], "active");
    assert_eq!(session["real_time"]["scheduler"], "not asked");
    assert!(session["device"]["name"].as_str().expect("a name").contains("simulated"), "{figures}");
    assert!(session["touch"]["contacts"].is_u64() && session["touch"]["coverage_ticks"]["cell"].is_u64());
    assert_eq!(
        (&figures["profile"]["name"], figures["profile"]["held"].is_boolean()),
        (&"Novint Falcon".into(), true)
    );
    assert!(
        figures["start_s"].as_f64().expect("seconds") > 0.0 && figures["blob_bytes"].is_u64(),
        "{figures}"
    );
    assert_eq!(figures["recording"]["ticks"].as_u64(), Some(ticks));
    assert!(csv.exists(), "the histograms are written all the same");

    let device = format!("replay:{}", text(&recording));
    let replayed = object(&["--device", &device]);
    assert_eq!(
        (&replayed["replay"]["identical"], replayed["replay"]["ticks"].as_u64()),
        (&true.into(), Some(ticks))
    );
}

#[test]
fn options_that_would_do_nothing_are_refused() {
    let change = ["run", BLOB, "--uncertified", "--headless", "--seconds", "0.1", "--change-every", "1"];
    refused(&change, &["--change-every", "name another"]);
}

#[test]
fn what_cannot_be_replayed_is_refused_in_one_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let (recording, other, frames) = (at("session.mcap"), at("other.mcap"), at("frames"));
    let shown = ["--headless", "--pictures", text(&frames)];
    let record = ["run", BLOB, "--uncertified", "--seconds", "0.2", "--record", text(&recording)];
    let (code, told) = said(&[&record[..], &shown].concat());
    assert_eq!(code, Some(0), "{told}");
    let device = |path: &Path| format!("replay:{}", text(path));
    let refused = |arguments: &[&str], words: &[&str]| refused(&[arguments, &shown].concat(), words);
    refused(&["run", BLOB, "--device", &device(&other)], &["other.mcap", "check the name"]);
    std::fs::write(&other, "not an MCAP file").expect("writable");
    refused(&["run", BLOB, "--device", &device(&other)], &["other.mcap", "not a recording of Palpate"]);
    let replay = device(&recording);
    refused(
        &["run", BLOB, "--device", &replay, "--seconds", "1"],
        &["leave --seconds, --profile and --record out"],
    );
    let mut bytes = std::fs::read(&recording).expect("there");
    let middle = bytes.len() / 2;
    let digit = middle + bytes[middle..].iter().position(u8::is_ascii_digit).expect("numbers");
    bytes[digit] ^= 1;
    std::fs::write(&other, &bytes).expect("writable");
    refused(&["run", BLOB, "--device", &device(&other)], &["other.mcap"]);
    // A different blob: the same organ under another name.
    let mut blob = std::fs::read(BLOB).expect("the golden blob");
    let end = blob.len() - 4;
    let scene = figures(&recording)["scene"].as_str().expect("a name").as_bytes().to_vec();
    let name =
        blob.windows(scene.len()).position(|bytes| bytes == scene).expect("the blob has its scene's name");
    blob[name] ^= 1;
    let sum = palpate_core::format::CHECKSUM.checksum(&blob[..end]);
    blob[end..].copy_from_slice(&sum.to_le_bytes());
    let altered = at("altered.blob");
    std::fs::write(&altered, &blob).expect("writable");
    refused(
        &["run", text(&altered), "--device", &replay],
        &["session.mcap", "another blob", "byte for byte"],
    );
}
