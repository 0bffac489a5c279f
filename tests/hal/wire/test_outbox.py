"""What goes out when: the dead man's rule on the wire's side."""

import numpy as np
import pytest

from hal.wire.outbox import Kind, Outbox
from hal.wire.shared import Boards
from world.actuation import JointCommand

KD = np.array([2.0, 3.0])
PERIOD_S = 0.02


@pytest.fixture
def rig():
    boards = Boards.of(memoryview(bytearray(Boards.size(2))), 2)
    return boards.commands, Outbox(boards.commands, KD, PERIOD_S, boards.pulse)


def command(value=1.0):
    return JointCommand(*(np.full(2, value + row) for row in range(5)))


def damping_of(outgoing):
    return outgoing.kind is Kind.DAMP and not outgoing.command.kp.any() and (outgoing.command.kd == KD).all()


def test_nothing_goes_out_before_the_devices_are_enabled(rig):
    board, outbox = rig
    assert outbox.at(0.0) == outbox.at(1.0)
    board.post(Kind.TRACK, 1.0, command())
    assert outbox.at(1.0).kind is Kind.IDLE and outbox.at(1.0).command is None
    outbox.energise()
    assert outbox.at(1.0).kind is Kind.TRACK


def test_enabled_without_a_command_is_damping(rig):
    _, outbox = rig
    outbox.energise()
    assert damping_of(outbox.at(0.0)) and not outbox.latched


def test_the_command_arrives_whole(rig):
    board, outbox = rig
    outbox.energise()
    board.post(Kind.TRACK, 5.0, command(7.0))
    sent = outbox.at(5.0).command
    for row, name in enumerate(("q_rad", "dq_rad_s", "kp", "kd", "tau_nm")):
        np.testing.assert_array_equal(getattr(sent, name), 7.0 + row)


def test_a_command_older_than_three_periods_is_damping_and_latches(rig):
    board, outbox = rig
    outbox.energise()
    board.post(Kind.TRACK, 10.0, command())
    assert outbox.at(10.06).kind is Kind.TRACK
    assert damping_of(outbox.at(10.0601))
    board.post(Kind.TRACK, 10.07, command())
    assert damping_of(outbox.at(10.07)) and outbox.latched
    outbox.acknowledge()
    assert damping_of(outbox.at(10.08)) and not outbox.latched
    board.post(Kind.TRACK, 10.09, command())
    assert outbox.at(10.09).kind is Kind.TRACK


def test_the_age_counts_from_the_writing_not_from_the_first_look(rig):
    board, outbox = rig
    outbox.energise()
    board.post(Kind.TRACK, 10.0, command())
    assert damping_of(outbox.at(10.1)) and outbox.latched


def test_a_wire_that_was_late_itself_obeys_a_fresh_command(rig):
    board, outbox = rig
    outbox.energise()
    board.post(Kind.TRACK, 10.0, command())
    assert outbox.at(10.0).kind is Kind.TRACK
    board.post(Kind.TRACK, 10.1, command())  # the ones in between were written and never looked at
    assert outbox.at(10.11).kind is Kind.TRACK and not outbox.latched


def test_damping_needs_no_renewal(rig):
    board, outbox = rig
    outbox.energise()
    board.post(Kind.DAMP, 0.0, command())
    assert damping_of(outbox.at(1000.0)) and not outbox.latched


def test_a_failure_damps_until_acknowledged_and_a_new_command(rig):
    board, outbox = rig
    outbox.energise()
    board.post(Kind.TRACK, 1.0, command())
    outbox.fail()
    assert damping_of(outbox.at(1.0))
    board.post(Kind.TRACK, 1.02, command())
    assert damping_of(outbox.at(1.02))
    outbox.acknowledge()
    assert damping_of(outbox.at(1.03))
    board.post(Kind.TRACK, 1.04, command())
    assert outbox.at(1.04).kind is Kind.TRACK


def test_after_the_halt_nothing_but_damping(rig):
    board, outbox = rig
    outbox.energise()
    outbox.halt()
    board.post(Kind.TRACK, 1.0, command())
    outbox.acknowledge()
    board.post(Kind.TRACK, 1.02, command())
    assert damping_of(outbox.at(1.02))


def test_a_wire_process_that_wakes_up_after_its_standby_has_taken_over_only_damps(rig):
    board, outbox = rig
    outbox.energise()
    board.post(Kind.TRACK, 0.0, command())
    assert outbox.at(0.0).kind is Kind.TRACK
    outbox._pulse.take()
    board.post(Kind.TRACK, 0.01, command())
    assert damping_of(outbox.at(0.01))
    outbox.acknowledge()
    board.post(Kind.TRACK, 0.02, command())
    assert damping_of(outbox.at(0.02))


def test_devices_that_another_controller_has_are_neither_commanded_nor_damped_nor_stood_by_for(rig):
    board, outbox = rig
    outbox._pulse.energise()
    outbox.energise()
    board.post(Kind.DAMP, 1.0, command())
    outbox.at(1.0)
    assert outbox._pulse.energised and outbox._pulse.damping_since_s == 1.0
    outbox.let_go()
    for again in (outbox.halt, outbox.acknowledge, outbox.energise):
        outbox._pulse.energise()  # as the wire process does before it enables
        again()
        board.post(Kind.TRACK, 1.02, command())
        assert outbox.at(1.02).kind is Kind.IDLE and not outbox.energised
    assert not outbox._pulse.energised and outbox._pulse.damping_since_s is None


def test_the_loop_is_told_since_when_damping_goes_out(rig):
    board, outbox = rig
    outbox.energise()
    board.post(Kind.TRACK, 1.0, command())
    outbox.at(1.0)
    assert outbox._pulse.damping_since_s == np.inf
    board.post(Kind.DAMP, 1.01, command())
    outbox.at(1.02)
    outbox.at(1.03)
    assert outbox._pulse.damping_since_s == 1.02
