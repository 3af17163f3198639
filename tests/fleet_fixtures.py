"""A queue of the tests' own, and what is put into it. What they need is imported by those that use them."""

import subprocess
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from harness.postgres import Server, server, tools

if TYPE_CHECKING:
    from scuhand_bt.fleet.needs import Offer
    from scuhand_bt.fleet.order import Submission
    from scuhand_bt.lab import Lab
    from scuhand_bt.recipe.plan import Plan


@pytest.fixture(scope="session")
def plan(tmp_path_factory: pytest.TempPathFactory) -> "Plan":
    from fleet_bench import plan_of
    from running import make_lab

    return plan_of(make_lab(tmp_path_factory.mktemp("lab")))


@pytest.fixture
def order(plan: "Plan") -> "Submission":
    from scuhand_bt.fleet.order import submission_of

    return submission_of(plan, simulated=True)


@pytest.fixture(scope="session")
def offer(starter: "Lab") -> "Offer":
    from scuhand_bt.fleet.needs import offer_of

    return offer_of(starter, simulated=True, unattended=False)


@pytest.fixture(scope="session")
def postgres() -> Iterator[Server]:
    """One for all modules of the group `postgres`, which one process runs: it takes seconds to start and to go."""
    if tools() is None:
        pytest.skip("no PostgreSQL here: apt install postgresql")
    with server() as made:
        yield made


@pytest.fixture
def database(postgres: Server, request: pytest.FixtureRequest) -> str:
    """A new database for each test."""
    name = f"d{abs(hash(request.node.nodeid))}"
    create = ["psql", "-X", "-q", postgres.address(), "-c", f"CREATE DATABASE {name}"]
    subprocess.run(create, check=True, capture_output=True)
    return postgres.address(name)
