"""What trainings leave behind is put back."""

from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True, scope="module")
def torch_threads() -> Iterator[None]:
    """Trainings set the number of torch's threads for their process."""
    torch = pytest.importorskip("torch")
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)
