"""Ctrl-C, on work that keeps nothing when it is stopped, and threads that get no memory."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from pgrssnn_jax.cli.process import Interrupted, ended_at_once, ended_without_memory, say, stop_signal

NO_MORE_MEMORY = """
import resource, threading, time
from pgrssnn_jax.cli.process import ended_without_memory

def begin_a_thread():
    thread = threading.Thread(target=lambda: None)
    thread.start()
    thread.join()

with ended_without_memory():
    begin_a_thread()  # its stack is kept for the next one
    resource.setrlimit(resource.RLIMIT_AS, (1 << 20, 1 << 20))
    for _ in range(200):
        try:
            begin_a_thread()
        except RuntimeError:  # the stack is not back yet
            time.sleep(0.05)
"""


def interrupt(number: signal.Signals = signal.SIGINT) -> None:
    os.kill(os.getpid(), number)
    time.sleep(5)  # whoever is interrupted does not get here


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_ends_work_where_it_stands(number):
    before, went_on = signal.getsignal(number), False
    with stop_signal() as stop:
        outer = signal.getsignal(number)
        with pytest.raises(Interrupted, match="start it"), ended_at_once(stop, "start it again"):  # noqa: PT012
            interrupt(number)
            went_on = True
        assert stop.is_set()
        assert signal.getsignal(number) is outer
    assert not went_on
    assert signal.getsignal(number) is before


def test_an_interrupt_that_a_library_turned_into_an_error_is_still_one():
    def callback() -> None:
        try:
            interrupt()
        except BaseException as problem:
            raise RuntimeError("INTERNAL: CpuCallback error") from problem

    with pytest.raises(Interrupted, match="stopped"), stop_signal() as stop, ended_at_once(stop, "stopped"):
        callback()


def test_an_interrupt_that_a_library_lost_is_left_in_the_event():
    with stop_signal() as stop:
        with ended_at_once(stop, "stopped"), contextlib.suppress(KeyboardInterrupt):
            interrupt()
        assert stop.is_set()
        with pytest.raises(Interrupted), ended_at_once(stop, "stopped"):
            raise AssertionError("begun although it was to stop")


def test_what_nobody_interrupted_keeps_its_result_and_its_errors():
    stop = threading.Event()
    with ended_at_once(stop, "stopped"):
        found = 1
    assert found == 1
    with pytest.raises(ValueError, match="bad"), ended_at_once(stop, "stopped"):
        raise ValueError("bad")


def test_in_another_thread_signals_stay_as_they_are():
    seen, stop = [], threading.Event()

    def work() -> None:
        with ended_at_once(stop, "stopped"):
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [signal.getsignal(signal.SIGINT)]


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits the memory of a process")
def test_a_thread_that_gets_no_memory_ends_the_process_with_a_sentence():
    ended = subprocess.run([sys.executable, "-c", NO_MORE_MEMORY], capture_output=True, text=True, timeout=60)
    assert ended.returncode == 2
    assert ended.stderr == "error: expected enough memory to go on, found none left; complete files stay\n"


def test_errors_of_finalizers_are_reported_as_before():
    class Broken:
        def __del__(self) -> None:
            raise ValueError("a finalizer")

    before, reported = sys.unraisablehook, threading.Event()
    seen = []

    def report(error) -> None:
        seen.append(str(error.exc_value))
        reported.set()

    sys.unraisablehook = report
    try:
        with ended_without_memory():
            Broken()
            assert reported.wait(10)
            assert seen == ["a finalizer"]
        assert sys.unraisablehook is report
    finally:
        sys.unraisablehook = before


def test_a_sentence_does_not_run_into_what_a_finalizer_reports(capsys, monkeypatch):
    begun = threading.Event()

    class Broken:
        def __del__(self) -> None:
            raise ValueError("a finalizer")

    def in_pieces(error) -> None:
        sys.stderr.write("    a line")
        begun.set()
        time.sleep(0.2)
        sys.stderr.write(" of a traceback\n")

    monkeypatch.setattr(sys, "unraisablehook", in_pieces)
    with ended_without_memory():
        Broken()
        assert begun.wait(10)
        say("the sentence")
    assert capsys.readouterr().err == "    a line of a traceback\nerror: the sentence\n"
