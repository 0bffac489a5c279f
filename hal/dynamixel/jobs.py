"""Conversations that one thread asks for and the thread that owns the port holds, between its rounds."""

from collections import deque
from concurrent.futures import Future

from core import robot_time as time
from hal.contract.types import DeviceError
from hal.dynamixel.setup import Job

JOB_S = 6.0


class JobQueue:
    """Jobs in the order in which they were handed over."""

    def __init__(self) -> None:
        self._jobs: deque[tuple[Job[None], Future[None]]] = deque()

    def hand_over(self, job: Job[None]) -> None:
        """Have the rounds' thread do a job, and wait. Raises what it raises; DeviceError where it takes too long."""
        done: Future[None] = Future()
        self._jobs.append((job, done))
        try:
            done.result(time.machine_s(JOB_S))
        except TimeoutError as error:
            done.cancel()
            raise DeviceError(f"not done within {JOB_S:g} s") from error

    def work(self, until_s: float) -> None:
        """Go on with the jobs that wait, as far as there is time; at least one exchange."""
        while self._jobs:
            job, done = self._jobs[0]
            try:
                if done.cancelled():
                    job.close()
                next(job)
            except StopIteration:
                self._jobs.popleft()
                if done.set_running_or_notify_cancel():
                    done.set_result(None)
            except Exception as error:
                self._jobs.popleft()
                if done.set_running_or_notify_cancel():
                    done.set_exception(error)
            if time.monotonic() >= until_s:
                return
