"""Figures as users see them."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def _figures_are_laid_out(figures_without_layout):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("contactimg.plots.axes.Figure", figures_without_layout)
        yield
