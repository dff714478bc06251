"""The report's driveline against numbers computed independently, and against the exact reference.

Tolerances come from RK4's truncation at h = 1e-4 s. For the contact mode, ω = 1623 1/s, the phase is late by
(ωh)⁵/120 a step, so a time by T_c (ωh)⁴/120 = 2e-8 s a contact period, and an amplitude is off by as much per radian:
2e-5 over half a period. Chatter magnifies a time by the ratio of the speeds of two touches in a row, ten or twenty-fold
over an episode.
"""

import numpy as np
import pytest
from helpers import reference

from clunk.simulation.trajectory import simulate
from clunk.study.config import study_from_text
from clunk.study.study import replace_values

TIME = 1e-6  # s
AMPLITUDE = 2e-5  # relative


def at(study, ratio, backlash, separation="gap", step=1e-4):
    study = replace_values(study, {"load.ratio": ratio, "lash.backlash_deg": backlash, "solver.step": step})
    contact = study.lash.contact.model_copy(update={"separation": separation})
    return study.model_copy(update={"lash": study.lash.model_copy(update={"contact": contact})})


def times_and_speeds(trajectory):
    """(time, q') of the primary impacts."""
    events = trajectory.events[trajectory.primaries]
    return events["time"], events["speed"]


def test_a_small_load_ratio_never_opens_the_gap(nominal):
    trajectory = simulate(at(nominal, 1.0, 6.0))
    assert len(trajectory.events) == 1
    assert trajectory.label == "NI"
    assert trajectory.severity == 0.0


def test_the_single_sided_impact_at_ratio_2(nominal):
    trajectory = simulate(at(nominal, 2.0, 6.0))
    assert len(trajectory.events) == 1 + 6
    time, speed = times_and_speeds(trajectory)
    assert time == pytest.approx([0.2158974], abs=TIME)
    assert speed == pytest.approx([-1.430961], rel=AMPLITUDE)
    assert list(trajectory.flanks) == [-1]
    assert trajectory.label == "SS(1)"
    assert trajectory.severity == pytest.approx(1212.7, abs=0.1)  # as many digits as are known


def test_the_nominal_run_is_that_of_figures_3_1_and_3_2(nominal):
    """The sequence opposite, initial, initial: DS(1)SS(1), with 18 events."""
    trajectory = simulate(nominal)
    assert len(trajectory.events) == 1 + 18
    time, speed = times_and_speeds(trajectory)
    assert time == pytest.approx([0.11914968, 0.26126542, 0.56499567], abs=TIME)
    assert speed == pytest.approx([8.624357, -6.640220, -1.360790], rel=5 * AMPLITUDE)
    assert list(trajectory.flanks) == [1, -1, -1]
    assert trajectory.letters == "O I I"
    assert trajectory.label == "DS(1)SS(1)"
    assert trajectory.impact_severity == pytest.approx([7316.5, 5623.3, 1154.1], abs=0.05 + 7316.5 * AMPLITUDE)
    assert trajectory.severity == pytest.approx(9299.7, abs=0.05 + 9299.7 * AMPLITUDE)
    assert trajectory.complete


def test_the_nominal_preload_is_static_equilibrium_on_the_negative_flank(nominal):
    trajectory = simulate(nominal)
    theta, speed = trajectory.states[0, :4], trajectory.states[0, 4:]
    assert theta == pytest.approx([-0.6300, -0.4383, -0.2466, -0.1917], abs=0.0003)
    assert np.all(speed == 0.0)
    assert trajectory.initial_side == -1
    # shafts 1-2 and 2-3 and the contact in series carry all of T(0⁻) = -6 N m
    assert theta[0] - theta[1] == pytest.approx(-6.0 / 31.3, rel=1e-12)
    indentation = -(theta[2] - theta[3]) - np.deg2rad(3.0)
    assert indentation * 0.08**2 * 4.092e5 == pytest.approx(6.0, rel=1e-10)


def test_two_double_sided_impacts_at_ratio_10(nominal):
    """At k34 = 4.09e5 N/m, for which the numbers were computed."""
    study = replace_values(at(nominal, 10.0, 10.0), {"lash.contact.stiffness": 4.09e5})
    trajectory = simulate(study)
    assert len(trajectory.events) == 1 + 32
    time, speed = times_and_speeds(trajectory)
    assert time == pytest.approx([0.1101488, 0.2671179, 0.4826656, 0.6388111, 0.9284417], abs=TIME)
    assert speed == pytest.approx([17.48973, -13.49554, 4.84184, -3.60564, -1.41822], rel=5 * AMPLITUDE)
    assert trajectory.label == "DS(2)SS(1)"


def test_the_severest_point_of_figure_3_7(nominal):
    """σr = 10, φθ = 16°, with the peaks located between the steps: 20374; sampling at the steps loses 2 to 5 %."""
    trajectory = simulate(at(nominal, 10.0, 16.0))
    assert trajectory.label == "DS(1)SS(2)"
    assert trajectory.severity == pytest.approx(20374.3, rel=AMPLITUDE)


@pytest.mark.parametrize("separation", ["gap", "force"])
@pytest.mark.parametrize(
    ("ratio", "backlash"),
    [
        (2.0, 6.0),
        (5.0, 6.0),
        (10.0, 10.0),
        (10.0, 16.0),
        (7.0, 2.0),
        (3.3, 12.0),
        (8.0, 0.5),
        (6.0, 20.0),
        (7.0, 0.0),
        (0.3, 0.0),
        (-1.6, 3.0),
        (-3.0, 6.0),
    ],
)
class TestAgainstTheExactReference:
    def test_every_event_and_every_severity(self, nominal, ratio, backlash, separation):
        study = at(nominal, ratio, backlash, separation)
        plant = reference.plant_of(study)
        events, _ = reference.run(plant)
        trajectory = simulate(study)
        assert [(trajectory.kind_name(k), int(event["side"])) for k, event in enumerate(trajectory.events)] == [
            (event.kind, event.side) for event in events
        ]
        assert trajectory.events["time"] == pytest.approx([event.time for event in events], abs=TIME)

        primaries = reference.primary_impacts(events, plant.contact_period())
        assert list(trajectory.primaries) == primaries
        exact = reference.severities(events, primaries)
        assert trajectory.impact_severity == pytest.approx(exact, rel=AMPLITUDE)
        assert trajectory.severity == pytest.approx(np.sqrt(np.sum(exact**2)), rel=AMPLITUDE)
        approach = np.sqrt(sum(events[k].speed ** 2 for k in primaries))
        assert trajectory.approach_velocity == pytest.approx(approach, rel=AMPLITUDE)


def test_the_reference_itself_agrees_with_a_general_integrator():
    """The first two primary impacts of the nominal run by SciPy's DOP853, so that not all rests on matrix exponentials.

    Its dense output is of order 7: at rtol 1e-12 the events are good to some 1e-11 s.
    """
    from scipy.integrate import solve_ivp

    plant = reference.boere(5.0, 6.0)
    damping, stiffness = plant.open_matrices()
    inertia, half, q = np.array(plant.inertias), plant.backlash / 2, plant.twist

    def slope(_, x, side):
        theta, speed = x[:4], x[4:]
        contact = plant.contact_stiffness * (q @ theta - side * half) + plant.contact_damping * (q @ speed)
        torque = plant.after * plant.load - stiffness @ theta - damping @ speed - abs(side) * contact * q
        return np.concatenate([speed, torque / inertia])

    def zero(side):
        def overlap(_, x, __):
            return side * (q @ x[:4]) - half

        overlap.terminal = True
        return overlap

    exact, _ = reference.run(plant)
    side, x = plant.preload()
    time, event_times = 0.0, []
    while len(event_times) < 8:
        ends = [zero(side)] if side else [zero(1), zero(-1)]
        for end in ends:
            end.direction = -1 if side else 1  # the zero that the last event left behind is not one
        solution = solve_ivp(
            slope, (time, 2.0), x, "DOP853", events=ends, args=(side,), rtol=1e-12, atol=1e-14, first_step=1e-6
        )
        which = next(k for k, times in enumerate(solution.t_events) if times.size)
        time, x = solution.t_events[which][0], solution.y_events[which][0]
        side = 0 if side else (1, -1)[which]
        event_times.append(time)
    assert event_times == pytest.approx([event.time for event in exact[1:9]], abs=1e-10)


class TestOneInertiaOnASpringContact:
    """One inertia of 5 kg m² that rebounds between two stops, from rest in one of them, without a load.

    Contact stiffness 2e4 N m/rad and damping 50 N m s/rad, total backlash π/4, from the relative angle π/2: a damped
    oscillator until separation, then constant speed. Times to 1e-7 s, speeds to their printed digits.
    """

    def run(self, separation, step=1e-5):
        study = study_from_text(
            f"""
            [driveline]
            inertias = [5.0]
            shafts = []
            [lash]
            between = [1, "ground"]
            backlash_deg = 45.0
            radius = 1.0
            [lash.contact]
            stiffness = 2e4
            damping = 50.0
            separation = "{separation}"
            [load]
            on = 1
            initial_torque = 0.0
            final_torque = 0.0
            [solver]
            step = {step}
            end_time = 0.05
            """
        )
        trajectory = simulate(study, initial_state=[np.pi / 2, 0.0])
        return trajectory, {
            (trajectory.kind_name(k), int(event["side"])): event for k, event in enumerate(trajectory.events)
        }

    def test_separation_by_force(self):
        trajectory, events = self.run("force")
        assert events["separation", 1]["time"] == pytest.approx(0.0236592158, abs=1e-7)
        assert events["opening", 1]["time"] == pytest.approx(0.0261592158, abs=1e-7)
        assert events["touch", -1]["time"] == pytest.approx(0.0380238426, abs=1e-7)
        assert events["touch", -1]["speed"] == pytest.approx(-66.196618, abs=1e-6)
        assert trajectory.initial_side == 1
        assert trajectory.flanks[0] == 1

    def test_separation_by_gap(self):
        _, events = self.run("gap")
        assert events["separation", 1]["time"] == pytest.approx(0.0261697, abs=5e-8)
        assert events["touch", -1]["speed"] == pytest.approx(-65.371, abs=5e-4)

    def test_closed_form_of_the_first_separation(self):
        """By force: k δ + c δ' = 0 of δ = δ0 e^(-ζωt)(cos ω_d t + ζω/ω_d sin ω_d t), solved for t."""
        omega = np.sqrt(2e4 / 5.0)
        decay = 50.0 / 5.0 / 2.0
        damped = np.sqrt(omega**2 - decay**2)
        # with δ' = -δ0 ω²/ω_d e^(-ζωt) sin ω_d t: tan ω_d t = ω_d / (c ω²/k - ζω)
        time = np.arctan2(damped, 50.0 / 2e4 * omega**2 - decay) / damped
        _, events = self.run("force")
        assert events["separation", 1]["time"] == pytest.approx(time, abs=1e-12)
