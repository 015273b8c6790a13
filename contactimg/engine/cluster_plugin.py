"""What all calls of a function have in common, on each worker of a cluster."""

from typing import Any

from distributed import WorkerPlugin


class CommonTask(WorkerPlugin):
    """A task that each worker has under the name of the plugin."""

    def __init__(self, task: Any) -> None:
        self.task = task
