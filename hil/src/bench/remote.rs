//! Remote procedure calls from a [`Rig`] in the guest to its device in the bench, where time advances only on
//! request.

use crate::fault::{FaultCounts, FaultKind, Faults};
use crate::force_record::ForceRecord;
use crate::mechanism::Waypoint;
use crate::rig::Rig;
use palpate_core::Vec3;
use serde::{Deserialize, Serialize};

/// A request to the bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RigRequest {
    /// Replaces the device by a new one, plugged in.
    NewDevice {
        /// Seed of its faults.
        seed: u64,
    },
    /// The guest starts to open a driver. Time advances while a transfer waits.
    BeginOpen,
    /// The driver is open. Its clock starts, and time stands still.
    EndOpen,
    /// Advances to a time. The reply holds the true positions of the grip.
    Advance {
        /// Start of the recorded positions, us.
        from_us: u64,
        /// End, us.
        until_us: u64,
        /// Sampling period of the recorded positions, us.
        every_us: u64,
        /// Delay the reply until the driver has processed all that the device sent and has posted another
        /// transfer.
        wait_for_driver: bool,
    },
    /// Reads the record of the force on the hand.
    ForceRecord,
    /// Reads the true position of the grip and the position that its encoders report.
    Position,
    /// Reads the counts of injected link faults.
    Counts,
    /// Resets the record of the force on the hand.
    ResetForceRecord,
    /// Moves the hand along another path.
    Follow(Vec<Waypoint>),
    /// Presses these buttons.
    PressButtons(u8),
    /// Sets the faults of the links to the device and to the host.
    Faults(Faults, Faults),
    /// Plugs the cable in again.
    Replug,
    /// Injects a fault of the cable or the device.
    InjectFault(FaultKind),
    /// Lets an encoder miscount.
    JumpEncoder {
        /// Index of the axis or motor.
        axis: usize,
        /// Approximate offset at the handle, m.
        by_m: f32,
    },
}

/// The reply.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RigReply {
    /// Done.
    Done,
    /// True positions of the grip, one for each sampling time.
    Positions(Vec<Vec3>),
    /// The record of the force on the hand.
    ForceRecord(ForceRecord),
    /// True position of the grip, and the position that its encoders report.
    Position(Vec3, Vec3),
    /// Counts of injected link faults.
    Counts(FaultCounts),
}

impl RigReply {
    /// Executes a request that concerns only the rig.
    pub fn of(rig: &mut dyn Rig, request: RigRequest) -> Self {
        match request {
            RigRequest::Advance { from_us, until_us, every_us, .. } => {
                let mut truth = Vec::new();
                rig.advance_noting(from_us, until_us, every_us.max(1), &mut truth);
                rig.advance(until_us);
                return Self::Positions(truth.into_iter().map(|(_, position_m)| position_m).collect());
            }
            RigRequest::ForceRecord => return Self::ForceRecord(rig.force_record()),
            RigRequest::Position => return Self::Position(rig.position_m(), rig.reported_m()),
            RigRequest::Counts => return Self::Counts(rig.counts()),
            RigRequest::ResetForceRecord => rig.reset_record(),
            RigRequest::Follow(path) => rig.follow(path),
            RigRequest::PressButtons(buttons) => rig.press(buttons),
            RigRequest::Faults(to_device, to_host) => rig.set_faults(to_device, to_host),
            RigRequest::Replug => rig.replug(),
            RigRequest::InjectFault(fault) => drop(rig.inject(fault)),
            RigRequest::JumpEncoder { axis, by_m } => rig.jump_encoder(axis, by_m),
            RigRequest::NewDevice { .. } | RigRequest::BeginOpen | RigRequest::EndOpen => {}
        }
        Self::Done
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::{Reply, Request};

    /// Numbers arrive as they were sent: all bits of a seed, and of a force.
    #[test]
    fn requests_and_replies_round_trip() {
        let faults = Faults { drop: 0.1, delay: 0.4, delay_us: 5, refuse: true, ..Faults::NONE };
        let path = vec![
            Waypoint { t_us: 1, position_m: [0.1, -0.2, 1e-9] },
            Waypoint { t_us: 400_000, position_m: [0.0; 3] },
        ];
        for request in [
            RigRequest::NewDevice { seed: u64::MAX - 6 },
            RigRequest::BeginOpen,
            RigRequest::Advance { from_us: 1, until_us: 1_000, every_us: 250, wait_for_driver: true },
            RigRequest::Follow(path),
            RigRequest::PressButtons(9),
            RigRequest::Faults(faults, Faults::NONE),
            RigRequest::InjectFault(FaultKind::UnplugMidFrame),
            RigRequest::JumpEncoder { axis: 2, by_m: -0.01 },
            RigRequest::ResetForceRecord,
        ] {
            let request = Request::Rig(request);
            let line = serde_json::to_string(&request).expect("plain data");
            assert_eq!(serde_json::from_str::<Request>(&line).ok(), Some(request), "{line}");
        }
        let felt = ForceRecord {
            force_n: [0.1, -2.0, 1e-7],
            largest_motor: 4_096,
            last_command_us: Some(0),
            off_since_us: None,
            work_j: -1e-3,
            ..ForceRecord::default()
        };
        for reply in [
            RigReply::Done,
            RigReply::Positions(vec![[0.1, 0.2, 0.3], [-1.0, 0.0, 1e-9]]),
            RigReply::ForceRecord(felt),
            RigReply::Counts(FaultCounts { corrupted: 3, ..FaultCounts::default() }),
        ] {
            let reply = Reply::Rig(reply);
            let line = serde_json::to_string(&reply).expect("plain data");
            assert_eq!(serde_json::from_str::<Reply>(&line).ok(), Some(reply), "{line}");
        }
    }
}
