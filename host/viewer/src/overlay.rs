//! Text over the picture: force, displacement, method and phase, timing, colour legend, strip charts.

use super::charts::Charts;
use super::font::{Align, TextStyle, Typeface};
use super::help::{self, Help};
use super::image::{Image, StrokeMask};
use super::live::Live;
use super::palette::{BAD, BRIGHT, ColourMap, FAINT, GOOD, MUTED, WAITING, packed};
use super::scene::{ACTIVE_COLOUR, FIXED_COLOUR, FORCE_COLOUR, magnitudes};
use super::verdict::Verdict;
use core::time::Duration;
use glam::Vec2;
use palpate_core::format::Tool;
use palpate_core::{Coverage, Phase, Solver};
use palpate_host::first_place::MAX_NAMED;
use palpate_host::live::LiveTick;
use palpate_host::rt::{SessionState, TickRecord};

/// Text for a model without displacements.
const FORCE_ONLY: &str = "forces only: the shape is not updated";

/// Text for a tool without a size.
const POINT_NOTE: &str = "a point or patch: its force depends on the mesh";

/// What happens while a live solver is behind the hand.
const BEHIND: [&str; 2] = ["extrapolated", "the solver is behind: the force levels off, then fades"];

/// What ends a fault.
const FAULT_HINT: &str = "the force is zero \u{b7} R resets, then hold Shift + A to arm";

/// Text of the overlay that is not in the records.
#[derive(Debug, Clone, Default)]
pub struct Captions {
    /// Scene name.
    pub scene: String,
    /// Material law.
    pub law: String,
    /// Interpolation method.
    pub method: String,
    /// Name of each active node.
    pub spaces: Vec<String>,
    /// The certificate's verdict on each active node of each model; unknown where there is none.
    pub verdicts: Vec<Vec<Verdict>>,
    /// The tool.
    pub tool: Tool,
    /// Depth of a sphere below the skin at rest, m.
    pub depth_m: f32,
    /// The area on which it presses, and the greatest pressure, where they are known.
    pub contact: Option<String>,
    /// Number of models of the session.
    pub models: usize,
    /// Whether the model has forces but no displacements.
    pub force_only: bool,
    /// A line under the title.
    pub note: String,
}

impl Captions {
    /// Scene, law, and the number of the model if there are several.
    fn line(&self, record: &TickRecord) -> String {
        let line = format!("{}  \u{b7}  {}", self.scene, self.law);
        if self.models < 2 {
            return line;
        }
        format!("{line}  \u{b7}  model {} of {}", record.model + 1, self.models)
    }

    /// The most severe verdict on the touched places; `None` if there are none.
    fn verdict(&self, record: &TickRecord) -> Option<Verdict> {
        let engaged = record.engaged?;
        let of = |space: u16| {
            let model = self.verdicts.get(usize::from(record.model));
            model.and_then(|spaces| spaces.get(usize::from(space))).copied().unwrap_or(Verdict::Unknown)
        };
        let shares = record.shares.iter().filter(|share| share.weight > 0.0);
        shares.map(|share| of(share.space)).max().or(Some(of(engaged)))
    }
}

/// Draws the overlay. Sizes are for a picture 720 pixels high and scale with it.
#[derive(Debug, Clone, Default)]
pub struct Overlay {
    face: Typeface,
    mask: StrokeMask,
    charts: Charts,
}

impl Overlay {
    /// Draws all parts of the overlay.
    pub fn draw(
        &mut self,
        image: &mut Image,
        captions: &Captions,
        record: &TickRecord,
        live: &mut Live,
        (map, full_scale_m): (&ColourMap, f32),
    ) {
        let scale = image.height() as f32 / 720.0;
        self.draw_title(image, captions, record, scale);
        self.draw_figures(image, captions, record, scale);
        self.draw_legend(image, captions, (map, full_scale_m), scale);
        self.draw_fault(image, record, scale);
        self.charts.draw(image, &mut self.face, live);
        self.draw_timing(image, record, live, scale);
    }

    /// Draws the help.
    pub fn draw_help(&mut self, image: &mut Image, help: Help) {
        help::draw(image, &mut self.face, help);
    }

    /// Writes the names of the active nodes beside them; `at` gives the pixel of each visible node.
    pub fn draw_names(&mut self, image: &mut Image, captions: &Captions, at: &[Option<Vec2>]) {
        let scale = image.height() as f32 / 720.0;
        // The names of many nodes would cover the organ.
        if at.len() > MAX_NAMED {
            return;
        }
        for (name, place) in captions.spaces.iter().zip(at) {
            if let Some(place) = place {
                let (x, y) = (place.x + 13.0 * scale, place.y + 4.5 * scale);
                let style = TextStyle::new(9.0 * scale, BRIGHT);
                self.face.draw_with_halo(image, name, (x, y), Align::Left, style);
            }
        }
    }

    fn text(&mut self, image: &mut Image, text: &str, x: f32, y: f32, align: Align, style: TextStyle) -> f32 {
        self.face.draw(image, text, x, y, align, style)
    }

    fn draw_title(&mut self, image: &mut Image, captions: &Captions, record: &TickRecord, scale: f32) {
        let (x, y) = (40.0 * scale, 56.0 * scale);
        let mark = TextStyle::new(19.0 * scale, BRIGHT);
        self.text(image, "palpate", x, y, Align::Left, mark);
        let style = TextStyle::new(9.5 * scale, MUTED);
        self.text(image, &captions.line(record), x, y + 28.0 * scale, Align::Left, style);
        if captions.force_only {
            // Without this text an organ that does not deform would look like a fault.
            let style = TextStyle { colour: WAITING, ..style };
            self.text(image, FORCE_ONLY, x, y + 46.0 * scale, Align::Left, style);
        } else {
            self.text(image, &captions.note, x, y + 46.0 * scale, Align::Left, style);
        }
    }

    fn draw_figures(&mut self, image: &mut Image, captions: &Captions, record: &TickRecord, scale: f32) {
        let right = image.width() as f32 - 40.0 * scale;
        let (force_n, mut displacement_m) = magnitudes(record);
        let label = TextStyle::new(9.5 * scale, MUTED);
        let mut y = 47.0 * scale;
        self.text(image, "force on the body", right, y, Align::Right, label);
        y += 41.0 * scale;
        self.figure(image, &format!("{force_n:.2}"), "N", (right, y), 29.0 * scale, FORCE_COLOUR);
        y += 34.0 * scale;
        let moved = match captions.tool {
            Tool::Point => "displacement of the node",
            Tool::Fingertip(_) => "displacement of the finger",
            Tool::Sphere(_) => "depth of the sphere",
            Tool::Capsule(_) => "depth of the capsule",
        };
        displacement_m = captions.tool.sphere().map_or(displacement_m, |_| captions.depth_m);
        self.text(image, moved, right, y, Align::Right, label);
        y += 34.0 * scale;
        self.figure(image, &format!("{:.1}", displacement_m * 1e3), "mm", (right, y), 22.0 * scale, BRIGHT);

        let touching = record.engaged.and_then(|index| captions.spaces.get(usize::from(index)));
        let touching = match captions.tool {
            Tool::Sphere(_) | Tool::Capsule(_) if captions.depth_m <= 0.0 => "\u{2013}",
            Tool::Sphere(_) | Tool::Capsule(_) => captions.contact.as_deref().unwrap_or("the skin"),
            Tool::Point | Tool::Fingertip(_) => touching.map_or("\u{2013}", String::as_str),
        };
        let (phase, colour) = match SessionState::of(record) {
            SessionState::SafeZero(_) => ("safe zero".to_owned(), BAD),
            state if state.has_force() => (state.to_string(), GOOD),
            state => (state.to_string(), WAITING),
        };
        let verdict = captions.verdict(record);
        let verdict = verdict.map_or(("\u{2013}", BRIGHT), |verdict| (verdict.word(), verdict.colour()));
        let jets = record.live.map(|live| solver(&live));
        // A live session is certified afterwards.
        let (quality, (word, shade)) = match &jets {
            Some((word, shade)) => ("solver", (word.as_str(), *shade)),
            None => ("verdict", verdict),
        };
        let coverage = record.coverage.map_or("\u{2013}", |coverage| coverage.name());
        let rows = [
            ("method", captions.method.as_str(), BRIGHT),
            ("touches", touching, BRIGHT),
            (quality, word, shade),
            ("data", coverage, if coverage == "extrapolated" { WAITING } else { BRIGHT }),
            ("phase", phase.as_str(), colour),
        ];
        let moment = format!("{:.1} mN m", 1e3 * palpate_core::vec3::norm(record.reaction_n_m));
        let of_capsule = captions.tool.half_axis_m().map(|_| ("moment", moment.as_str(), BRIGHT));
        y += 14.0 * scale;
        for (name, value, colour) in of_capsule.into_iter().chain(rows) {
            y += 21.0 * scale;
            let style = TextStyle::new(9.5 * scale, colour);
            self.text(image, value, right, y, Align::Right, style);
            self.text(image, name, right - 175.0 * scale, y, Align::Left, label);
        }
        if captions.tool == Tool::Point {
            let style = TextStyle::new(9.0 * scale, MUTED);
            self.text(image, POINT_NOTE, right, y + 26.0 * scale, Align::Right, style);
        }
    }

    /// Draws the reason of a fault prominently, or that the force is extrapolated.
    fn draw_fault(&mut self, image: &mut Image, record: &TickRecord, scale: f32) {
        if let Phase::SafeZero(fault) = record.phase {
            self.draw_banner(image, (fault.name(), BAD, 0x2a_0d0b), FAULT_HINT, scale);
        } else if record.live.is_some() && record.coverage == Some(Coverage::Extrapolated) {
            let [text, hint] = BEHIND;
            self.draw_banner(image, (text, WAITING, 0x2a_1f0b), hint, scale);
        }
    }

    /// Draws the countdown until the device is armed.
    pub(super) fn draw_arming(&mut self, image: &mut Image, remaining: Option<Duration>) {
        let Some(remaining) = remaining else { return };
        let scale = image.height() as f32 / 720.0;
        let text = format!("arming in {:.1} s", remaining.as_secs_f32());
        self.draw_banner(image, (&text, WAITING, 0x2a_1f0b), "release to cancel", scale);
    }

    /// Draws a line and a hint over the picture, at the top.
    fn draw_banner(&mut self, image: &mut Image, line: (&str, u32, u32), hint: &str, scale: f32) {
        let (text, colour, background) = line;
        let middle = 0.5 * image.width() as f32;
        let style = TextStyle::new(15.0 * scale, colour);
        let width = self.face.width_px(text, style.height_px).max(300.0 * scale) + 56.0 * scale;
        let (left, top) = ((middle - 0.5 * width) as i32, (22.0 * scale) as i32);
        image.fill_rect(left, top, width as i32, (56.0 * scale) as i32, background, 0.85);
        self.text(image, text, middle, 46.0 * scale, Align::Centre, style);
        let style = TextStyle::new(9.5 * scale, BRIGHT);
        self.text(image, hint, middle, 68.0 * scale, Align::Centre, style);
    }

    /// A large number followed by a small unit, right-aligned.
    fn figure(
        &mut self,
        image: &mut Image,
        value: &str,
        unit: &str,
        (right, y): (f32, f32),
        size: f32,
        colour: u32,
    ) {
        let small = TextStyle::new(size * 0.48, colour);
        let width = self.text(image, unit, right, y, Align::Right, TextStyle { alpha: 0.8, ..small });
        let style = TextStyle::new(size, colour);
        self.text(image, value, right - width - 0.32 * size, y, Align::Right, style);
    }

    fn draw_legend(
        &mut self,
        image: &mut Image,
        captions: &Captions,
        (map, full_scale_m): (&ColourMap, f32),
        scale: f32,
    ) {
        let (width, height) = (9.0 * scale, 190.0 * scale);
        let left = image.width() as f32 - 40.0 * scale - width;
        let top = image.height() as f32 - 92.0 * scale - height;
        for row in 0..height as i32 {
            let t = 1.0 - (row as f32 + 0.5) / height;
            let colour = packed(map.linear(t));
            image.fill_rect(left as i32, top as i32 + row, width.round() as i32, 1, colour, 1.0);
        }
        let label = TextStyle::new(9.5 * scale, MUTED);
        let full_mm = full_scale_m * 1e3;
        let steps = legend_steps(full_mm);
        for step in 0..=steps {
            let share = step as f32 / steps as f32;
            let y = top + height * (1.0 - share);
            let text = format!("{:.0}", full_mm * share);
            let middle = y.min(top + height - 0.5).max(top + 0.5);
            image.fill_rect(
                (left - 6.0 * scale) as i32,
                middle as i32,
                (4.0 * scale).ceil() as i32,
                scale.ceil() as i32,
                FAINT,
                1.0,
            );
            self.text(image, &text, left - 12.0 * scale, y + 4.5 * scale, Align::Right, label);
        }
        self.text(image, "displacement, mm", left + width, top - 18.0 * scale, Align::Right, label);
        let mut y = image.height() as f32 - 62.0 * scale;
        let places = match captions.tool {
            Tool::Point => Some("active nodes"),
            Tool::Fingertip(_) => Some("contact points"),
            Tool::Sphere(_) | Tool::Capsule(_) => None,
        };
        let places = places.map(|places| (places, ACTIVE_COLOUR));
        for (name, colour) in [("fixed", FIXED_COLOUR)].into_iter().chain(places) {
            self.text(image, name, left + width - 18.0 * scale, y + 4.5 * scale, Align::Right, label);
            self.dot(image, (left + width - 5.0 * scale, y), 4.5 * scale, colour);
            y += 20.0 * scale;
        }
    }

    fn dot(&mut self, image: &mut Image, (x, y): (f32, f32), radius: f32, colour: u32) {
        let reach = radius.ceil() as i32 + 2;
        self.mask.reset(
            x as i32 - reach,
            y as i32 - reach,
            (2 * reach) as usize + 1,
            (2 * reach) as usize + 1,
        );
        self.mask.segment([x, y], [x, y], radius, 1.0);
        self.mask.paint(image, colour, 1.0);
    }

    fn draw_timing(&mut self, image: &mut Image, record: &TickRecord, live: &mut Live, scale: f32) {
        let (x, y) = (40.0 * scale, image.height() as f32 - 26.0 * scale);
        let text = format!(
            "1 kHz tick p99 {:.1} \u{b5}s   wake-up p99 {:.1} \u{b5}s   missed ",
            live.compute_p99_us(),
            live.lateness_p99_us()
        );
        let style = TextStyle::new(9.5 * scale, MUTED);
        let width = self.text(image, &text, x, y, Align::Left, style);
        let colour = if record.skipped_periods == 0 { GOOD } else { WAITING };
        let missed = record.skipped_periods.to_string();
        self.text(image, &missed, x + width + 3.0 * scale, y, Align::Left, TextStyle { colour, ..style });
    }
}

/// What a live solver does, and the colour of it.
fn solver(live: &LiveTick) -> (String, u32) {
    match live.solver {
        Solver::Alive => (format!("{} jets", live.jets), GOOD),
        Solver::Silent => ("silent".into(), WAITING),
        Solver::Gone => ("gone".into(), BAD),
    }
}

/// Number of steps of the legend's scale; each is a round number of mm: 3 for 15, 4 for 20, 5 for 5, 10, 25
/// and 50.
fn legend_steps(full_mm: f32) -> u32 {
    let step_mm = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0]
        .into_iter()
        .find(|step| {
            full_mm / step <= 5.01 && (full_mm / step).fract().min(1.0 - (full_mm / step).fract()) < 0.01
        })
        .unwrap_or(full_mm);
    (full_mm / step_mm).round().max(1.0) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_core::Fault;

    fn drawn(record: &TickRecord) -> Image {
        let captions = Captions { scene: "liver".into(), method: "hybrid".into(), ..Captions::default() };
        drawn_with(record, &captions)
    }

    fn drawn_with(record: &TickRecord, captions: &Captions) -> Image {
        let mut image = Image::new(640, 360);
        let mut live = Live::new();
        for tick in 0..2_000 {
            live.push(&TickRecord { t_us: tick * 1_000, ..*record });
        }
        Overlay::default().draw(&mut image, captions, record, &mut live, (&ColourMap::new(), 0.02));
        image
    }

    #[test]
    fn a_fault_and_the_force_are_visible() {
        let calm = drawn(&TickRecord { phase: Phase::Active, ..TickRecord::EMPTY });
        let fault = drawn(&TickRecord { phase: Phase::SafeZero(Fault::Stale), ..TickRecord::EMPTY });
        let red = |image: &Image| {
            image
                .pixels()
                .iter()
                .filter(|&&pixel| pixel >> 16 > 0xa0 && (pixel >> 8 & 0xff) < 0x90 && pixel & 0xff < 0x90)
                .count()
        };
        assert!(red(&fault) > red(&calm) + 10, "{} {}", red(&fault), red(&calm));
        let pushing = drawn(&TickRecord { reaction_n: [0.0, 3.0, 0.0], ..TickRecord::EMPTY });
        assert_ne!(pushing, drawn(&TickRecord::EMPTY));
    }

    #[test]
    fn the_countdown_is_drawn_while_it_runs() {
        let bright = |remaining| {
            let mut image = Image::new(640, 360);
            Overlay::default().draw_arming(&mut image, remaining);
            image.pixels().iter().filter(|pixel| **pixel != 0).count()
        };
        assert_eq!(bright(None), 0);
        assert!(bright(Some(Duration::from_millis(700))) > 1_000);
    }

    /// The title names the model if there are several, and states that a model without displacements does not
    /// deform.
    #[test]
    fn the_title_names_the_model_and_its_lack_of_displacements() {
        let record = TickRecord { model: 1, ..TickRecord::EMPTY };
        let captions = Captions { scene: "liver".into(), law: "mooney-rivlin".into(), ..Captions::default() };
        assert_eq!(captions.line(&record), "liver  \u{b7}  mooney-rivlin");
        let several = Captions { models: 3, ..captions.clone() };
        assert_eq!(several.line(&record), "liver  \u{b7}  mooney-rivlin  \u{b7}  model 2 of 3");
        let force_only = Captions { force_only: true, ..captions.clone() };
        let plain = drawn_with(&record, &captions);
        // Rows in which the pictures differ, of 360.
        let rows = |image: &Image| -> Vec<usize> {
            let rows = image.pixels().chunks(640).zip(plain.pixels().chunks(640)).enumerate();
            rows.filter(|(_, (a, b))| a != b).map(|(row, _)| row).collect()
        };
        for (captions, above, below) in [(several, 33, 46), (force_only, 43, 55)] {
            let changed = rows(&drawn_with(&record, &captions));
            assert!(
                !changed.is_empty() && changed.iter().all(|row| (above..below).contains(row)),
                "{changed:?}"
            );
        }
        let line = |text| Typeface::new().width_px(text, 9.5);
        assert!(line(FORCE_ONLY) < 400.0 && FORCE_ONLY.is_ascii());
    }

    #[test]
    fn the_legend_has_marks_at_whole_numbers() {
        let marks = [5.0, 10.0, 15.0, 20.0, 25.0, 50.0, 100.0].map(legend_steps);
        assert_eq!(marks, [5, 5, 3, 4, 5, 5, 5]);
        assert_eq!(legend_steps(0.0), 1);
    }

    /// Every size down to a thumbnail: no index may be outside the picture.
    #[test]
    fn any_size_of_picture_is_drawn() {
        for (width, height) in [(1, 1), (16, 9), (320, 200), (200, 900)] {
            let mut image = Image::new(width, height);
            let record = TickRecord { phase: Phase::Active, ..TickRecord::EMPTY };
            let mut live = Live::new();
            live.push(&record);
            Overlay::default().draw(
                &mut image,
                &Captions::default(),
                &record,
                &mut live,
                (&ColourMap::new(), 0.02),
            );
        }
    }
}
