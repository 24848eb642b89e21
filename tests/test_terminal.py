"""What the terminal shows of a result, and what the shell completes."""

import pytest

from uavaccel.cli.completion import experiments, one_of
from uavaccel.cli.run import columns_within
from uavaccel.draw.document import Table

TABLE = Table(
    ("command", "effective speed-up", "source"), [("ADSC", "11.23", "modelled"), ("TCSC", "-", "x")]
)


@pytest.mark.parametrize(("width", "columns"), [(80, 3), (28, 3), (27, 2), (18, 2), (17, 1), (3, 1)])
def test_a_table_shows_the_columns_that_fit_uncut(width: int, columns: int) -> None:
    assert (
        columns_within(TABLE, width) == columns
    )  # "command", "effective" and "modelled", two characters apart


def test_words_of_options_and_experiments_are_completed() -> None:
    assert one_of("wall", "virtual", "lockstep")("v") == ["virtual"]
    assert experiments("dp") == ["dp1", "dp2", "dp2_airsim"]
    assert "claims" not in experiments("")
