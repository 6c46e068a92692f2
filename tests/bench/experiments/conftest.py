import pytest

from spoofgym.bench.experiments import Store, run_experiment

from .support import Numbers, content


@pytest.fixture(scope="package")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    run_experiment(Numbers(), Store(folder))
    return content(folder)
