"""A mass-spring hand against the controller, tick by tick in virtual time: python simulated_hand.py SCENE
FOLDER

The hand is a mass m that a spring k with damping c pulls to a target: m a = k (target - x) - c v + f, where f
is the force of the controller, held for a tick of 1 ms. The target presses 5 mm into the organ within half a
second, rests, and leaves. FOLDER holds organ.blob of the scene (force_map.py makes it) and gets touch.mcap.
"""

import sys

import numpy as np
import palpate

MASS_KG, SPRING_N_M, DAMPING_N_S_M = 0.15, 800.0, 12.0
TICK_S, SUB_STEPS = 1e-3, 10


def target_height_m(time_s: float) -> float:
    """Height of the target above the skin: from 3 mm to -5 mm, a rest, and back."""
    share = np.clip(min(time_s - 0.2, 2.2 - time_s) / 0.5, 0.0, 1.0)
    return 3e-3 - 8e-3 * 0.5 * (1 - np.cos(np.pi * share))


def touch(organ: palpate.Organ, record: str) -> "tuple[list[palpate.Command], np.ndarray]":
    """The commands of 2.4 s, and the velocity of the hand at each, m/s."""
    normal, place_m = organ.normals[0].astype(float), organ.active_m[0].astype(float)
    x_m, v_m_s = place_m + target_height_m(0.0) * normal, np.zeros(3)
    commands, velocities_m_s = [], []
    with palpate.Controller(organ, record=record, ramp_s=0.1) as controller:
        controller.arm()
        for tick in range(2400):
            command = controller.tick(1000 * tick, x_m)
            target_m = place_m + target_height_m(TICK_S * tick) * normal
            for _ in range(SUB_STEPS):
                force_n = SPRING_N_M * (target_m - x_m) - DAMPING_N_S_M * v_m_s + command.hand_force_n
                v_m_s = v_m_s + TICK_S / SUB_STEPS / MASS_KG * force_n
                x_m = x_m + TICK_S / SUB_STEPS * v_m_s
            commands.append(command)
            velocities_m_s.append(v_m_s)
    return commands, np.array(velocities_m_s)


def main(scene_file: str, folder: str) -> None:
    """Touches the organ, and compares the force at rest with the finite-element solution."""
    organ = palpate.Organ(f"{folder}/organ.blob")
    commands, velocities_m_s = touch(organ, f"{folder}/touch.mcap")
    assert all(command.phase == "active" for command in commands), "no fault"
    at_rest = commands[1650]
    speed_m_s = np.abs(velocities_m_s[1600:1690]).max()
    assert speed_m_s < 1e-3, f"the hand does not come to rest: {speed_m_s} m/s"
    assert commands[-1].engaged is None and not commands[-1].hand_force_n.any(), "the hand has left"
    exact_n = (
        palpate.Scene(scene_file).path([0.5 * at_rest.displacement_m, at_rest.displacement_m]).force_n[-1]
    )
    error_n = np.linalg.norm(-at_rest.hand_force_n - exact_n)
    for tick in range(0, 2400, 200):
        print(f"{TICK_S * tick:4.1f} s {np.linalg.norm(commands[tick].hand_force_n):7.3f} N")
    print(f"at rest {np.linalg.norm(exact_n):.3f} N, {1e3 * error_n:.2f} mN from the finite-element solution")
    assert error_n < 0.02, "within what can be felt"


if __name__ == "__main__":
    main(*sys.argv[1:3])
