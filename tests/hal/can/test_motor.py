"""How old an answer is, where questions and answers go their own ways."""

from hal.can.motor import Unanswered


def ages_of(delay_rounds: int, lost: frozenset[int] = frozenset(), rounds: int = 60) -> list[tuple[float, float]]:
    """(age given, true age) in rounds of every answer, where the question of round k is answered in k + delay."""
    waiting, arriving, ages = Unanswered(), {}, []
    heard = False
    for k in range(rounds):
        asks = waiting.begin_round(heard)
        heard = False
        if asks:
            waiting.ask(float(k))
            arriving[k + delay_rounds] = k
        if k in arriving and arriving[k] not in lost:
            heard = True
            ages.append((k - waiting.answer(), float(k - arriving[k])))
    return ages


def test_slow_answers_show_their_true_age() -> None:
    for delay in (0, 1, 3, 6):
        assert all(given == true for given, true in ages_of(delay))


def test_after_a_lost_answer_ages_are_soon_true_again_and_never_too_low() -> None:
    ages = ages_of(0, frozenset({4, 5, 30}))
    assert all(given >= true for given, true in ages)
    assert max(given for given, _ in ages) <= 2.0
    assert all(given == true for given, true in ages[-10:])
