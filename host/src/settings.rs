//! The settings of controller and arming for organs on a device: the same in a session, on the bench and in
//! the tools.

use crate::device::DeviceInfo;
use crate::device::profile::{Buttons, Profile};
use palpate_core::{Config, Method, Organ, clamp_force};

/// Margin of the workspace round the organ, m.
const WORKSPACE_MARGIN_M: f32 = 0.3;

/// Height, in encoder counts, by which a pushing tool rises before contact is released. A smaller value
/// causes contact chatter.
const HYSTERESIS_COUNTS: f32 = 4.0;

/// The default settings, without a method where jets give the force, with every limit lowered to those of the device, the organs and the profile.
///
/// Hand and encoder values (speed, resolution, energy) are in device metres. With a profile they are
/// multiplied by the workspace scale to model metres.
#[must_use]
pub fn controller_config<const N: usize>(
    organs: &[&Organ<'_, N>],
    method: impl Into<Option<Method>>,
    device: &DeviceInfo,
    profile: Option<&Profile>,
) -> Config {
    let mut config = method.into().map_or_else(Config::live, Config::new);
    let (limits, contact, passivity) = (&mut config.limits, &mut config.contact, &mut config.passivity);
    limits.max_stiffness_n_m = limits.max_stiffness_n_m.min(device.max_stiffness_n_m);
    // A scene without a device and an ideal simulated device do not raise the default limit.
    let weakest_n = organs.iter().fold(f32::INFINITY, |smallest, organ| smallest.min(organ.max_force_n));
    limits.max_force_n = limits.max_force_n.min(device.max_force_n).min(weakest_n);
    // The workspace is a box round the model's origin. An organ in scanner coordinates may be far from it.
    let places = organs.iter().flat_map(|organ| organ.surface.position_m).flatten();
    let reach_m = places.fold(0.0f32, |largest, x| largest.max(x.abs()));
    limits.max_position_m = limits.max_position_m.max(reach_m + WORKSPACE_MARGIN_M);
    passivity.position_step_m = device.resolution_m;
    if let Some(profile) = profile {
        profile.lower_limits(limits);
        // A position that the handle cannot reach is a fault.
        limits.max_position_m = profile.largest_position_m();
        let scale = profile.workspace.scale;
        limits.max_speed_m_s *= scale;
        passivity.workspace_scale = scale;
        passivity.force_delay_us = profile.force_delay_us;
        let count_m = scale * profile.mechanism.encoder_quantum_m.unwrap_or(0.0);
        passivity.position_step_m = passivity.position_step_m.max(count_m);
        // The organ keeps half of the force limit, which a scene may lower.
        let (weight_n, _) = clamp_force(profile.gravity_compensation_n(), 0.5 * limits.max_force_n);
        config.gravity_compensation_n = weight_n;
        contact.release_height_m = contact.release_height_m.max(HYSTERESIS_COUNTS * count_m);
        contact.grasp_button = profile.buttons.grasp;
    }
    // A finger only presses: its springs would pull the skin.
    if organs.iter().any(|organ| !organ.tool.grasps()) {
        contact.grasp_button = 0;
    }
    config
}

/// The bits of the buttons that arm a device ([`LoopConfig::arm_button`](crate::rt::LoopConfig)): those of its
/// profile, or the first. A device that arms itself has none.
#[must_use]
pub fn arm_button(device: &DeviceInfo, profile: Option<&Profile>) -> u32 {
    if device.self_arming { 0 } else { profile.map_or_else(Buttons::default, |profile| profile.buttons).arm }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::Device;
    use crate::device::simulated::{SimulatedConfig, SimulatedHand};
    use crate::synthetic;
    use palpate_core::format::{Fingertip, Tool};

    #[test]
    fn the_workspace_scale_multiplies_hand_values_and_the_device_limits_apply() {
        let blob = synthetic::organ(&synthetic::Shape::default());
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let config_for = |profile: Option<&Profile>| {
            let simulated = profile.map_or_else(SimulatedConfig::default, SimulatedConfig::for_profile);
            let info = SimulatedHand::new(&organ, simulated).info();
            controller_config(&[&organ], Method::Trilinear, &info, profile)
        };
        let (ideal, default) = (config_for(None), Config::new(Method::Trilinear));
        assert_eq!((ideal.limits, ideal.contact), (default.limits, default.contact));
        assert_eq!((ideal.passivity.position_step_m, ideal.passivity.force_delay_us), (30e-6, 0));

        let mut profile = Profile::bundled("falcon").expect("bundled");
        assert_eq!((profile.workspace.scale, profile.force_delay_us), (3.0, 107));
        let falcon = config_for(Some(&profile));
        assert_eq!(falcon.limits.max_speed_m_s, 3.0 * default.limits.max_speed_m_s);
        assert_eq!((falcon.passivity.workspace_scale, falcon.passivity.force_delay_us), (3.0, 107));
        assert!((falcon.limits.max_stiffness_n_m - 1_000.0 / 3.0).abs() < 1e-3);
        assert!((falcon.limits.max_position_m - 0.132).abs() < 1e-6);
        // Four counts of 54 um, times the scale of 3.
        assert!((falcon.contact.release_height_m - 648e-6).abs() < 1e-9);
        assert!((falcon.passivity.position_step_m - 162e-6).abs() < 1e-9);
        // A finer encoder does not lower the height below the default.
        (profile.workspace.scale, profile.max_force_n) = (1.0, 2.5);
        profile.mechanism.encoder_quantum_m = Some(1e-6);
        let fine = config_for(Some(&profile));
        assert_eq!(fine.contact.release_height_m, default.contact.release_height_m);
        assert_eq!((fine.limits.max_force_n, fine.limits.max_speed_m_s), (2.5, 2.0));
    }

    #[test]
    fn arming_and_grasping_have_their_own_buttons_where_the_device_has_them() {
        let blob = synthetic::organ(&synthetic::Shape::default());
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let simulated = SimulatedHand::new(&organ, SimulatedConfig::default()).info();
        let motors = DeviceInfo { self_arming: false, ..simulated.clone() };
        for (name, arm, grasp) in [("falcon", 0b10, 0b1), ("polhem", 0b1, 0b1), ("link", 0b1, 0b1)] {
            let profile = Profile::bundled(name).expect("bundled");
            assert_eq!(arm_button(&motors, Some(&profile)), arm, "{name}");
            assert_eq!(arm_button(&simulated, Some(&profile)), 0, "{name}: it arms itself");
            let config = controller_config(&[&organ], Method::Trilinear, &motors, Some(&profile));
            assert_eq!(config.contact.grasp_button, grasp, "{name}");
        }
        assert_eq!(arm_button(&motors, None), 1);
    }

    #[test]
    fn a_fingertip_does_not_grasp() {
        let blob = synthetic::organ(&synthetic::Shape::default());
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let info = SimulatedHand::new(&organ, SimulatedConfig::default()).info();
        let grasp_button = |organ: &Organ<'_>| {
            let profile = Profile::bundled("link").expect("bundled");
            controller_config(&[organ], Method::Trilinear, &info, Some(&profile)).contact.grasp_button
        };
        assert_eq!(grasp_button(&organ), 1);
        let tip = Fingertip { radius_m: 0.01, stiffness_n_m: 500.0 };
        assert_eq!(grasp_button(&Organ { tool: Tool::Fingertip(tip), ..organ }), 0);
    }

    #[test]
    fn scene_and_device_limit_the_force() {
        let soft = synthetic::Shape { max_force_n: 3.0, ..synthetic::Shape::default() };
        let blob = synthetic::organ(&soft);
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let info = SimulatedHand::new(&organ, SimulatedConfig::default()).info();
        let config = controller_config(&[&organ], Method::Trilinear, &info, None);
        assert_eq!(config.limits.max_force_n, 3.0);
        let weak = DeviceInfo { max_force_n: 1.0, max_stiffness_n_m: 200.0, ..info };
        let config = controller_config(&[&organ], Method::Trilinear, &weak, None);
        assert_eq!((config.limits.max_force_n, config.limits.max_stiffness_n_m), (1.0, 200.0));
    }
}
