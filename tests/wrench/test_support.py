"""Laws of the wrench space's support function and of the sampled estimate of its boundary."""

import numpy as np
import pytest

from bidexdata.wrench.contact_model import contact_frames
from bidexdata.wrench.support import (
    AXES,
    force_support,
    sampled_boundary,
    sampled_score,
)


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def stability_score(normals_in, *, mu):
    """The paper's score without samples: the largest force in the worst of the six directions."""
    return force_support(normals_in, AXES, mu=mu).min(axis=-1)


def contacts(rng, count):
    """Contacts on a ball of 15 cm, normals in, a little off the radius."""
    d = unit(rng.standard_normal((count, 3)))
    return 0.15 * d, unit(-d + 0.2 * rng.standard_normal((count, 3)))


@pytest.mark.parametrize("mu", [0.0, 0.3, 1.0])
def test_support_is_the_best_of_many_allowed_forces(mu):
    rng = np.random.default_rng(0)
    _, n = contacts(rng, 4)
    t = np.concatenate([unit(rng.standard_normal((30, 3))), AXES, -n])
    angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    rim = np.stack([np.ones(720), mu * np.cos(angle), mu * np.sin(angle)], axis=1)
    reach = np.zeros(len(t))
    for R in contact_frames(n):
        reach += np.maximum((t @ R) @ rim.T, 0.0).max(axis=1)
    # The rim has 720 points: short by at most mu (1 - cos(0.25 deg)) per contact.
    assert np.all(force_support(n, t, mu=mu) >= reach - 1e-12)
    assert np.allclose(force_support(n, t, mu=mu), reach, atol=4 * mu * 1e-5 + 1e-12)


def test_supports_of_two_contact_sets_add():
    rng = np.random.default_rng(1)
    _, a = contacts(rng, 5)
    _, b = contacts(rng, 3)
    both = force_support(np.concatenate([a, b]), AXES, mu=0.3)
    apart = force_support(a, AXES, mu=0.3) + force_support(b, AXES, mu=0.3)
    assert np.allclose(both, apart, atol=1e-12)


def test_two_opposed_contacts_resist_by_friction_sideways():
    n = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    assert np.allclose(force_support(n, AXES, mu=0.3), [1, 1, 0.6, 0.6, 0.6, 0.6])
    assert stability_score(n, mu=0.3) == pytest.approx(0.6)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_contacts_that_all_push_one_way_resist_no_pull_that_way(count):
    n = np.tile([0.0, 0.0, 1.0], (count, 1))
    support = force_support(n, AXES, mu=0.3)
    assert support.shape == (6,)
    assert support[5] == 0.0
    assert stability_score(n, mu=0.3) == 0.0


@pytest.mark.parametrize("smooth", [True, False])
def test_sampled_wrenches_lie_within_the_support(smooth):
    rng = np.random.default_rng(2)
    t = np.concatenate([AXES, unit(rng.standard_normal((20, 3)))])
    for _ in range(10):
        p, n = contacts(rng, 10)
        u = unit(rng.standard_normal((500, 3)))
        w = sampled_boundary(p, n, u, mu=0.3, length=0.15, smooth=smooth)
        assert np.all(w[:, :3] @ t.T <= force_support(n, t, mu=0.3) + 1e-9)


def test_the_smooth_support_points_are_the_estimators():
    """By hand for one contact with mu = 0.5, whose cone ends at 26.6 degrees: TDG's three cases."""
    degrees = np.radians([0, 15, 60, 120, 180])
    u = np.stack([np.cos(degrees), np.sin(degrees), 0 * degrees], axis=1)
    w = sampled_boundary(np.zeros((1, 3)), np.array([[1.0, 0, 0]]), u, mu=0.5, length=1.0)
    # Through the disc; on the rim; the rim fading out as sin / (sin - 2 mu cos) behind the contact.
    behind = np.sqrt(0.75) / (np.sqrt(0.75) + 0.5)
    expected = [[1, 0], [1, np.tan(degrees[1])], [1, 0.5], [behind, 0.5 * behind], [0, 0]]
    np.testing.assert_allclose(w[:, :2], expected, atol=1e-9)
    np.testing.assert_allclose(w[:, 2:], 0, atol=1e-12)


def test_the_estimators_score_is_lower_and_ranks_alike():
    """What docs/paper_to_code.md says of the score that the paper takes from TDG."""
    from scipy.stats import spearmanr

    rng = np.random.default_rng(3)
    u = unit(rng.standard_normal((1000, 3)))
    exact, smooth = [], []
    for _ in range(150):
        p, n = contacts(rng, 10)
        exact.append(float(stability_score(n, mu=0.3)))
        smooth.append(sampled_score(p, n, u, mu=0.3, length=0.15))
    ratio = np.array(smooth) / np.array(exact)
    assert 0.4 < np.median(ratio) < 0.6
    assert ratio.max() < 1
    assert 0.9 < spearmanr(exact, smooth).statistic < 0.97


def test_the_closed_form_is_the_limit_of_the_sampled_score():
    from scipy.stats import spearmanr

    rng = np.random.default_rng(3)
    u = unit(rng.standard_normal((1000, 3)))
    exact, sampled = [], []
    for _ in range(60):
        p, n = contacts(rng, 10)
        exact.append(float(stability_score(n, mu=0.3)))
        sampled.append(sampled_score(p, n, u, mu=0.3, length=0.15, smooth=False))
    exact, sampled = np.array(exact), np.array(sampled)
    # 1000 directions leave about 4 degrees to the axis, which costs a few percent of the support.
    assert np.all(sampled <= exact + 1e-9)
    assert np.all(sampled >= 0.9 * exact)
    assert np.median(sampled / exact) > 0.98
    assert spearmanr(exact, sampled).statistic > 0.99
