//! Strip charts of the last seconds: the force, and the wake-up lateness of the loop.

use super::font::{Align, TextStyle, Typeface};
use super::image::{Image, StrokeMask};
use super::live::{Live, Moment, SPAN_US};
use super::palette::{BRIGHT, FAINT, MUTED, WAITING};
use super::scene::FORCE_COLOUR;

/// Colour of the lateness.
const LATE_COLOUR: u32 = 0xa9_b8ff;
/// Decades of the lateness chart: 1 us at the bottom, 10 ms at the top.
const DECADES: f32 = 4.0;
/// Decade of the next deadline: a tick with this lateness is lost.
const DEADLINE_DECADE: f32 = 3.0;

/// The two charts; sizes are for a picture 720 pixels high.
#[derive(Debug, Clone, Default)]
pub(super) struct Charts {
    mask: StrokeMask,
    /// Top of the force scale, N; it only increases.
    top_n: f32,
}

/// Position of a chart, in pixels.
#[derive(Clone, Copy)]
struct Frame {
    left: f32,
    bottom: f32,
    width: f32,
    height: f32,
    scale: f32,
}

impl Frame {
    fn at(&self, age_s: f32, share: f32) -> [f32; 2] {
        let span_s = SPAN_US as f32 * 1e-6;
        [self.left + self.width * (1.0 - age_s / span_s), self.bottom - self.height * share.clamp(0.0, 1.0)]
    }
}

impl Charts {
    pub(super) fn draw(&mut self, image: &mut Image, face: &mut Typeface, live: &Live) {
        let scale = image.height() as f32 / 720.0;
        let bottom = image.height() as f32 - 56.0 * scale;
        let force = Frame { left: 40.0 * scale, bottom, width: 380.0 * scale, height: 78.0 * scale, scale };
        self.draw_force(image, face, live, force);
        let late = Frame { left: 492.0 * scale, width: 280.0 * scale, ..force };
        // A narrow picture has no room for the second chart.
        if late.left + late.width + 240.0 * scale < image.width() as f32 {
            self.draw_lateness(image, face, live, late);
        }
    }

    fn draw_force(&mut self, image: &mut Image, face: &mut Typeface, live: &Live, frame: Frame) {
        self.top_n = chart_top(live.peak_n()).max(self.top_n);
        let top_n = self.top_n;
        for share in [0.0, 0.5, 1.0] {
            let value = top_n * share;
            let text = if value.fract() == 0.0 { format!("{value:.0}") } else { format!("{value:.1}") };
            rule(image, face, frame, share, (&text, if share == 0.0 { 0.9 } else { 0.35 }, FAINT));
        }
        self.fill(image, frame, live, FORCE_COLOUR, |moment| moment.reaction_n / top_n);
        self.line(image, frame, live, (FORCE_COLOUR, 0.8), |moment| moment.reaction_n / top_n);
        self.line(image, frame, live, (BRIGHT, 0.5), |moment| moment.hand_force_n / top_n);
        let y = frame.bottom - frame.height - 14.0 * frame.scale;
        let label = TextStyle::new(9.5 * frame.scale, FORCE_COLOUR);
        let width = face.draw(image, "force, N", frame.left, y, Align::Left, label);
        let x = frame.left + width + 12.0 * frame.scale;
        let hand = TextStyle { colour: BRIGHT, ..label };
        face.draw(image, "for the hand", x, y, Align::Left, hand);
        let span = format!("last {:.0} s", SPAN_US as f32 * 1e-6);
        let muted = TextStyle { colour: MUTED, ..label };
        face.draw(image, &span, frame.left + frame.width, y, Align::Right, muted);
    }

    /// The scale is logarithmic, from a microsecond to beyond the next deadline.
    fn draw_lateness(&mut self, image: &mut Image, face: &mut Typeface, live: &Live, frame: Frame) {
        for (decade, text) in [(0.0, "1 \u{b5}s"), (1.0, "10"), (2.0, "100"), (DEADLINE_DECADE, "1 ms")] {
            let deadline = decade == DEADLINE_DECADE;
            let (alpha, colour) = match (decade == 0.0, deadline) {
                (_, true) => (0.75, WAITING),
                (true, _) => (0.9, FAINT),
                _ => (0.35, FAINT),
            };
            rule(image, face, frame, decade / DECADES, (text, alpha, colour));
        }
        let share = |moment: &Moment| lateness_share(moment.lateness_ns);
        self.fill(image, frame, live, LATE_COLOUR, share);
        self.line(image, frame, live, (LATE_COLOUR, 0.6), share);
        let y = frame.bottom - frame.height - 14.0 * frame.scale;
        let label = TextStyle::new(9.5 * frame.scale, LATE_COLOUR);
        face.draw(image, "wake-up lateness", frame.left, y, Align::Left, label);
        let deadline = TextStyle { colour: WAITING, ..label };
        face.draw(image, "deadline", frame.left + frame.width, y, Align::Right, deadline);
    }

    fn points(frame: Frame, live: &Live, share: impl Fn(&Moment) -> f32) -> Vec<[f32; 2]> {
        live.history().map(|(age_s, moment)| frame.at(age_s, share(moment))).collect()
    }

    fn fill(
        &self,
        image: &mut Image,
        frame: Frame,
        live: &Live,
        colour: u32,
        share: impl Fn(&Moment) -> f32,
    ) {
        for pair in Self::points(frame, live, share).windows(2) {
            for x in pair[0][0].round() as i32..pair[1][0].round() as i32 {
                // A column may be up to half a pixel beyond its points: interpolate, do not extrapolate.
                let t = ((x as f32 - pair[0][0]) / (pair[1][0] - pair[0][0]).max(1e-3)).clamp(0.0, 1.0);
                let y = pair[0][1] + (pair[1][1] - pair[0][1]) * t;
                image.fill_rect(x, y.ceil() as i32, 1, (frame.bottom - y.ceil()) as i32, colour, 0.13);
            }
        }
    }

    fn line(
        &mut self,
        image: &mut Image,
        frame: Frame,
        live: &Live,
        (colour, half_width): (u32, f32),
        share: impl Fn(&Moment) -> f32,
    ) {
        let (left, top) = (frame.left as i32 - 4, (frame.bottom - frame.height) as i32 - 4);
        self.mask.reset(left, top, frame.width as usize + 12, frame.height as usize + 12);
        self.mask.polyline(&Self::points(frame, live, share), half_width * frame.scale);
        self.mask.paint(image, colour, 1.0);
    }
}

/// A horizontal line with its value on the right.
fn rule(
    image: &mut Image,
    face: &mut Typeface,
    frame: Frame,
    share: f32,
    (text, alpha, colour): (&str, f32, u32),
) {
    let Frame { left, width, scale, .. } = frame;
    let y = (frame.bottom - frame.height * share) as i32;
    image.fill_rect(left as i32, y, width as i32, (scale.round() as i32).max(1), colour, alpha);
    let marked = if colour == FAINT { MUTED } else { colour };
    let label = TextStyle::new(8.5 * scale, marked);
    face.draw(image, text, left + width + 10.0 * scale, y as f32 + 4.5 * scale, Align::Left, label);
}

/// Height of a lateness in the chart: 0 at up to a microsecond, 1 at 10 ms.
fn lateness_share(lateness_ns: u64) -> f32 {
    let us = lateness_ns as f32 * 1e-3;
    (us.max(1.0).log10() / DECADES).min(1.0)
}

/// Round top of the chart above a peak: 1, 2, 4, 6, 8, 10, 20 .. N.
fn chart_top(peak_n: f32) -> f32 {
    [1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 20.0, 40.0, 100.0]
        .into_iter()
        .find(|top| peak_n <= 0.97 * top)
        .unwrap_or(1000.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_host::rt::TickRecord;

    #[test]
    fn the_chart_has_room_above_its_peak() {
        assert_eq!(chart_top(0.0), 1.0);
        assert_eq!(chart_top(3.99), 6.0);
        assert_eq!(chart_top(7.5), 8.0);
        assert_eq!(chart_top(5000.0), 1000.0);
    }

    #[test]
    fn lateness_is_drawn_by_decades() {
        let shares = [0, 1_000, 10_000, 100_000, 1_000_000, 1_000_000_000].map(lateness_share);
        assert_eq!(shares, [0.0, 0.0, 0.25, 0.5, 0.75, 1.0]);
    }

    /// Highest blue pixel of the lateness; lines and deadline are grey and yellow.
    fn highest(image: &Image) -> Option<usize> {
        // The frame of the chart without the text above it.
        (720 - 56 - 78..720 - 56)
            .find(|&y| (492..772).any(|x| image.pixel(x, y).is_some_and(|pixel| pixel & 0xff > 0x78)))
    }

    #[test]
    fn a_late_tick_is_a_spike_up_to_its_decade() {
        let drawn = |late_ns: u64| {
            let mut live = Live::new();
            for tick in 0..4_000 {
                let lateness_ns = if tick == 2_000 { late_ns } else { 2_000 };
                live.push(&TickRecord { t_us: tick * 1_000, lateness_ns, ..TickRecord::EMPTY });
            }
            let mut image = Image::new(1280, 720);
            Charts::default().draw(&mut image, &mut Typeface::new(), &live);
            highest(&image).expect("a line")
        };
        let (calm, late, lost) = (drawn(2_000), drawn(100_000), drawn(1_000_000));
        // 78 pixels for four decades. The line is a pixel wide, so a peak may be one pixel lower.
        assert!((calm - late).abs_diff(33) <= 2, "{calm} {late}");
        assert!((late - lost).abs_diff(19) <= 2, "{late} {lost}");
    }
}
