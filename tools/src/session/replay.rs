//! The replay of a recording: the loop runs over it again, and every force is compared.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use palpate_core::{Method, Organ};
use palpate_host::BlobFile;
use palpate_record::Recording;
use palpate_record::replay::{self, Pace, ReplayError};
use palpate_viewer::Regions;
use serde_json::{Value, json};

use super::SessionArgs;
use crate::failure::Failure;
use crate::interrupt::stop_flag;
use crate::{output, summary, touch};

/// A recording to replay. It needs no certificate, because the forces drive no device.
pub(crate) struct Replay<'a> {
    args: &'a SessionArgs,
    path: &'a Path,
    recording: Recording<BufReader<File>>,
}

impl<'a> Replay<'a> {
    /// Opens the recording at `path`, and refuses arguments that have no effect on a replay.
    pub(crate) fn open(args: &'a SessionArgs, path: &'a Path) -> Result<Self, Failure> {
        if args.record.is_some() || args.seconds.is_some() || args.profile.is_some() {
            return Err(Failure::input(
                "a replay is as long as its recording, has its limits, and is not recorded again: leave --seconds, --profile \
                 and --record out",
            ));
        }
        if args.control.is_some() {
            return Err(Failure::input("a replay moves no motors: leave --control out"));
        }
        if args.histograms.is_some() {
            return Err(Failure::input("a replay has no timing of its own: leave --histograms out"));
        }
        let source = File::open(path).map_err(|error| Failure::file(path, &error))?;
        let recording = Recording::open(BufReader::new(source))
            .map_err(|error| Failure::input(format!("{}: {error}", path.display())))?;
        Ok(Self { args, path, recording })
    }

    /// The blob of a live session, which the recording holds.
    pub(crate) fn organ(&self) -> Option<&BlobFile> {
        self.recording.organ()
    }

    /// Runs the loop over the recording; `of` says what was touched, for JSON.
    pub(crate) fn run<const N: usize>(
        mut self,
        organs: &[&Organ<'_, N>],
        blob_blake3: &[String],
        method: Option<Method>,
        regions: Option<&Regions>,
        mut of: Value,
    ) -> Result<(), Failure> {
        let path = self.path.display();
        let named = |error: &dyn std::fmt::Display| format!("{path}: {error}");
        let header = self.recording.header();
        replay::check_blobs(header, blob_blake3).map_err(|error| Failure::input(named(&error)))?;
        let name = method.or(header.config.method).map_or("jets", Method::name);
        let stop = stop_flag()?;
        let show = touch::Show { regions, ..self.args.show(None) };
        let had_folder = show.pictures.exists();
        let mut screen = show.screen(organs, name)?;
        let pace = match screen.interval() {
            None => Pace::Unseen,
            Some(_) if screen.is_window() => Pace::RealTime,
            Some(interval) => Pace::Recorded(interval),
        };
        let replayed =
            replay::replay(organs, blob_blake3, &mut self.recording, method, &stop, &mut screen, pace);
        if let Err(ReplayError::Model(_)) = &replayed {
            show.discard(had_folder);
        }
        let frames = screen.finish();
        let summary = replayed.map_err(|error| Failure::input(named(&error)))?;
        let frames = frames.map_err(|error| show.screen_failure(error))?;
        if self.args.json {
            of["recording"] = json!(self.path);
            of["replay"] = summary::replay(&summary, frames);
            output::line(format!("{of:#}"))?;
        } else {
            let text = touch::with_frames(&summary, frames);
            output::line(format!("method       {name}\n{text}"))?;
        }
        if summary.method == summary.recorded_method && summary.different > 0 {
            return Err(Failure::work(named(&format!("{} of its ticks differ", summary.different))));
        }
        if summary.ticks == 0 && !summary.is_stopped {
            return Err(Failure::work(named(&"contains no tick to replay")));
        }
        if summary.lost > 0 || summary.lost_jets > 0 {
            return Err(Failure::work(named(&"records are missing, so only a part was replayed")));
        }
        Ok(())
    }
}
