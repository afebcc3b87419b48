"""Claims: the strongest of somebody else's, at whichever gate of the robot it was made."""

from hostlink.robot.claims import MAX_CLAIMS, Claim, Claims

BASE, ARM = "base", "arm"


def claims(*made: tuple[str, str, int, float]) -> Claims:
    """Of (gate, owner, priority, deadline)."""
    ours = Claims()
    for gate, owner, priority, deadline_s in made:
        ours.put(gate, Claim(owner, priority, deadline_s))
    return ours


def test_the_strongest_is_the_most_important_and_of_those_the_last() -> None:
    ours = claims((BASE, "ann", 60, 1.0), (ARM, "bob", 60, 2.0), (ARM, "cat", 50, 3.0))
    assert ours.strongest_beside("dan", 0.0) == Claim("bob", 60, 2.0)
    assert ours.strongest_beside("bob", 0.0) == Claim("ann", 60, 1.0)


def test_a_claim_ends_at_its_deadline() -> None:
    ours = claims((BASE, "ann", 60, 1.0))
    assert ours.strongest_beside("bob", 0.999) == Claim("ann", 60, 1.0)
    assert ours.strongest_beside("bob", 1.0) is None
    assert not claims((BASE, "ann", 60, 1.0)).has_any(BASE, 1.0)


def test_a_gates_claims_are_its_own_to_remove_and_to_clear() -> None:
    ours = claims((BASE, "ann", 60, 1.0), (ARM, "ann", 50, 1.0), (ARM, "bob", 40, 1.0))
    ours.remove(BASE, "ann")
    ours.remove(BASE, "nobody")
    assert (ours.has_any(BASE, 0.0), ours.has_any(ARM, 0.0)) == (False, True)
    assert ours.strongest_beside("bob", 0.0) == Claim("ann", 50, 1.0)
    ours.put(BASE, Claim("cat", 30, 1.0))
    ours.clear(ARM)
    assert ours.strongest_beside("bob", 0.0) == Claim("cat", 30, 1.0)


def test_over_the_bound_the_least_important_goes_whichever_gate_it_is_at() -> None:
    ours = claims(*((BASE, str(number), 50, 1.0) for number in range(MAX_CLAIMS - 1)), (ARM, "least", 10, 9.0))
    assert not ours.put(BASE, Claim("0", 50, 2.0))  # a newer one of the same owner
    assert ours.put(ARM, Claim("one more", 50, 1.0))
    assert ours.strongest_beside("0", 5.0) is None
