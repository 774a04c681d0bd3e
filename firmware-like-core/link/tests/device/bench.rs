//! A device under test, and a host that records sessions and sequence numbers.

use palpate_link::{
    Device, DeviceFault, DeviceInfo, DeviceMessage, DeviceProfile, HostMessage, Inputs, Outputs, Phase,
    VERSION, message,
};

pub(crate) const WATCHDOG_US: u64 = 10_000;
pub(crate) const LIMIT_UNM: [u32; 3] = [500_000, 400_000, 250_000];
pub(crate) const TORQUE_UNM: [i32; 3] = [100_000, -200_000, 50];

pub(crate) fn profile() -> DeviceProfile {
    DeviceProfile {
        info: DeviceInfo {
            dof: 3,
            counts_per_turn: [4096; 3],
            torque_limit_unm: LIMIT_UNM,
            watchdog_us: WATCHDOG_US as u16,
            serial: 17,
            firmware: 1,
        },
        max_speed_counts_per_s: 20_000,
        boot: 0,
    }
}

/// A device under test, and a host that records sessions and sequence numbers.
pub(crate) struct Bench {
    pub(crate) device: Device,
    pub(crate) now_us: u64,
    pub(crate) inputs: Inputs,
    pub(crate) session: u32,
    pub(crate) seq: u32,
}

impl Bench {
    pub(crate) fn new() -> Self {
        let device = Device::new(profile()).expect("a good profile");
        let inputs = Inputs { encoders: [5, -6, 7], buttons: 2, homed: true, fault: false };
        let mut bench = Self { device, now_us: 5_000_000, inputs, session: 0, seq: 0 };
        assert_eq!(bench.step(0), Outputs::default());
        bench
    }

    pub(crate) fn linked() -> Self {
        let mut bench = Self::new();
        bench.hello();
        bench
    }

    pub(crate) fn unhomed() -> Self {
        let mut bench = Self::linked();
        bench.inputs.homed = false;
        bench.step(100);
        bench
    }

    pub(crate) fn homing() -> Self {
        let mut bench = Self::unhomed();
        bench.receive(HostMessage::Home { session: bench.session, seq: 1 });
        bench.seq = 1;
        bench.step(100);
        assert_eq!(bench.device.phase(), Phase::Homing);
        bench
    }

    pub(crate) fn enabled() -> Self {
        let mut bench = Self::linked();
        let enable = bench.enable();
        assert!(bench.answer_is(enable, true) && bench.device.phase() == Phase::Enabled);
        bench
    }

    pub(crate) fn faulted() -> Self {
        let mut bench = Self::enabled();
        bench.inputs.fault = true;
        bench.step(100);
        bench.inputs.fault = false;
        bench.step(100);
        assert_eq!(bench.device.phase(), Phase::Faulted(DeviceFault::Hardware));
        bench
    }

    pub(crate) fn step(&mut self, after_us: u64) -> Outputs {
        self.now_us += after_us;
        self.device.step(self.now_us, &self.inputs)
    }

    pub(crate) fn receive(&mut self, message: HostMessage) -> Option<DeviceMessage> {
        self.device.receive(self.now_us, &message)
    }

    pub(crate) fn hello(&mut self) {
        match self.receive(HostMessage::Hello { version: VERSION, nonce: 77 }) {
            Some(DeviceMessage::HelloAck { version: VERSION, nonce: 77, session, info }) => {
                assert!(session != 0 && session != self.session && info == profile().info);
                self.session = session;
                self.seq = 0;
            }
            other => panic!("{other:?}"),
        }
    }

    pub(crate) fn next(&mut self) -> (u32, u32) {
        self.seq = self.seq.wrapping_add(1);
        (self.session, self.seq)
    }

    pub(crate) fn enable(&mut self) -> Option<DeviceMessage> {
        let (session, seq) = self.next();
        self.receive(HostMessage::Enable { session, seq })
    }

    pub(crate) fn command_of(&mut self, torque_unm: [i32; 3], valid_for_us: u16) -> HostMessage {
        let (session, seq) = self.next();
        HostMessage::Command { session, seq, t_host_us: self.now_us as u32, torque_unm, valid_for_us }
    }

    pub(crate) fn command(&mut self, torque_unm: [i32; 3], valid_for_us: u16) -> Option<DeviceMessage> {
        let command = self.command_of(torque_unm, valid_for_us);
        self.receive(command)
    }

    /// Whether the answer is the state with the newest number, and its flags report the request as done or
    /// refused.
    pub(crate) fn answer_is(&self, answer: Option<DeviceMessage>, done: bool) -> bool {
        matches!(answer, Some(DeviceMessage::State { seq_echo, flags, .. })
            if seq_echo == self.seq && (flags & message::REFUSED == 0) == done)
    }
}
