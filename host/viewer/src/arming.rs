//! The chord that arms a device from the window: it must be held, and a countdown shows how long still.

use core::time::Duration;
use palpate_host::rt::{SessionState, TickRecord};

/// Time for which the chord is held.
const HOLD: Duration = Duration::from_secs(1);
/// Longest part of the time between two pictures that counts: a window that stood still saw no key.
const MAX_STEP: Duration = Duration::from_millis(100);

/// State of the chord.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ArmingChord {
    /// Held since the start, a change of the session's state or a countdown: it must first be released.
    Spent,
    /// Released.
    Released,
    /// Held for this long.
    Held(Duration),
}

impl ArmingChord {
    /// Takes the keys of a picture, `step` after the last one; true if the device is to be armed. Anything but a
    /// homed and disarmed session ends the countdown.
    pub(super) fn update(&mut self, is_held: bool, step: Duration, record: &TickRecord) -> bool {
        let is_ready = SessionState::of(record) == SessionState::Homed;
        *self = match *self {
            _ if !is_held => Self::Released,
            Self::Spent => Self::Spent,
            _ if !is_ready => Self::Spent,
            Self::Released => Self::Held(Duration::ZERO),
            Self::Held(time) => Self::Held(time + step.min(MAX_STEP)),
        };
        let is_complete = matches!(self, Self::Held(time) if *time >= HOLD);
        if is_complete {
            *self = Self::Spent;
        }
        is_complete
    }

    /// Ends a countdown; the chord must be released before the next.
    pub(super) fn cancel(&mut self) {
        *self = Self::Spent;
    }

    /// Time until the device is armed, while the countdown runs.
    pub(super) fn remaining(self) -> Option<Duration> {
        if let Self::Held(time) = self { Some(HOLD.saturating_sub(time)) } else { None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_core::{Fault, Phase};
    use palpate_host::device::DeviceState;

    const FRAME: Duration = Duration::from_millis(33);

    fn homed() -> TickRecord {
        TickRecord { device: DeviceState::Homed, phase: Phase::Disarmed, ..TickRecord::EMPTY }
    }

    /// Number of pictures of a chord that is held until the device is armed; at most 100.
    fn pictures(chord: &mut ArmingChord, step: Duration, record: &TickRecord) -> Option<usize> {
        (0..100).find(|_| chord.update(true, step, record))
    }

    #[test]
    fn a_chord_held_for_a_second_arms_once() {
        let mut chord = ArmingChord::Released;
        assert_eq!(pictures(&mut chord, FRAME, &homed()), Some(31));
        assert_eq!(pictures(&mut chord, FRAME, &homed()), None, "it must be released");
        assert!(!chord.update(false, FRAME, &homed()));
        assert_eq!(pictures(&mut chord, FRAME, &homed()), Some(31));
    }

    #[test]
    fn a_release_starts_the_countdown_again() {
        let mut chord = ArmingChord::Released;
        for picture in 0..1_000 {
            assert!(!chord.update(picture % 30 != 29, FRAME, &homed()), "{picture}");
        }
        assert!(!chord.update(false, FRAME, &homed()) && chord.remaining().is_none());
        assert!(!chord.update(true, FRAME, &homed()));
        assert_eq!(chord.remaining(), Some(HOLD));
        assert!(!chord.update(true, FRAME, &homed()));
        assert_eq!(chord.remaining(), Some(HOLD - FRAME));
    }

    #[test]
    fn a_chord_held_at_the_start_or_through_a_reset_does_not_arm() {
        let mut chord = ArmingChord::Spent;
        assert_eq!(pictures(&mut chord, FRAME, &homed()), None);
        for other in [
            TickRecord { phase: Phase::SafeZero(Fault::Stale), ..homed() },
            TickRecord { device: DeviceState::Unhomed, ..homed() },
            TickRecord { phase: Phase::Active, ..homed() },
        ] {
            let mut chord = ArmingChord::Released;
            assert_eq!(pictures(&mut chord, FRAME, &other), None);
            assert_eq!((pictures(&mut chord, FRAME, &homed()), chord.remaining()), (None, None), "{other:?}");
        }
    }

    #[test]
    fn a_window_that_stood_still_counts_a_tenth_of_a_second() {
        let mut chord = ArmingChord::Released;
        assert_eq!(pictures(&mut chord, Duration::from_secs(60), &homed()), Some(10));
    }

    #[test]
    fn a_cancelled_countdown_does_not_go_on() {
        let mut chord = ArmingChord::Released;
        assert!(!chord.update(true, FRAME, &homed()) && !chord.update(true, FRAME, &homed()));
        chord.cancel();
        assert_eq!((chord.remaining(), pictures(&mut chord, FRAME, &homed())), (None, None));
    }
}
