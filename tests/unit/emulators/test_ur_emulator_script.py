"""URScript on the emulated controller: values, threads, and what it refuses."""

import os
import random

import pytest

from helpers.hardware.emulated_ur import cycle, follow, settle
from surg_emulators.ur.robot_states import Runtime
from surg_emulators.ur.ur_controller import UrController
from surg_emulators.ur.urscript_machine import Machine
from surg_emulators.ur.urscript_syntax import ScriptError

FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
SCRIPTS = 100_000 if FULL else 1_500
NOISE = "while True : end if ( ) [ ] p[ 1 2.5 = == , sync() run"


def result(body: str, cycles: int = 20) -> list[float]:
    """Output registers 0 to 3 after a program."""
    controller = UrController()
    ran = controller.run_script(f"def test():\n{body}\nend\n")
    assert ran, controller.messages
    for _ in range(cycles):
        cycle(controller)
    assert controller.program is None, controller.messages
    return controller.outputs["double"][:4]


def out(value: str) -> str:
    return f"write_output_float_register(0, {value})"


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("1 + 2 * 3", 7.0),
        ("(1 + 2) * 3 - -4", 13.0),
        ("7 % 4 / 2", 1.5),
        ("0x10 + .5 + 1e-1", 16.6),
        ("[1, 2, 3][1 + 1]", 3.0),
        ("p[1, 2, 3, 0, 0, 0][2]", 3.0),
        ("pose_trans(p[1, 0, 0, 0, 0, d2r(90)], p[1, 0, 0, 0, 0, 0])[1]", 1.0),
        ("norm([3, 4])", 5.0),
        ("(2 * [3, 4])[1]", 8.0),
        ("([3, 4] * 0.5)[0]", 1.5),
        ("get_list_length([3, 4] * 2)", 2.0),
        ("([3, 4] / 2 - [0, 1])[1]", 1.0),
        ("get_joint_positions()[2]", -1.5708),
        ("get_steptime()", 0.002),
        ("get_actual_joint_positions()[1]", -1.5708),
    ],
)
def test_expressions_have_their_values(expression: str, expected: float) -> None:
    assert result(out(expression))[0] == pytest.approx(expected)


@pytest.mark.parametrize(
    "expression",
    [
        "not False and True",
        "False or not (1 > 2)",
        "True xor False",
        "1 <= 1 and 2 != 3 and 4 == 4.0",
        '"a" == "a"',
        "False and nothing or True",
    ],
)
def test_conditions_are_true(expression: str) -> None:
    assert result(f"if {expression}:\n {out('1')}\nend")[0] == 1.0


def test_loops_branches_and_functions() -> None:
    body = """
      def factorial(n):  # recursive
        if n < 2:
          return 1
        elif n == 100:
          return 0
        else:
          return n * factorial(n - 1)
        end
      end
      sum = 0
      i = 0
      while True:
        i = i + 1
        if i == 3:
          continue
        end
        if i > 5:
          break
        end
        sum = sum + i
      end
      write_output_float_register(0, sum)
      write_output_float_register(1, factorial(5))
    """
    assert result(body)[:2] == [12.0, 120.0]


def test_variables_of_the_outer_function_are_shared_and_locals_are_not() -> None:
    body = """
      global a = 1
      b = 2
      def change(c, d=4):
        a = a + 10
        b = b + 20
        local e = c + d
        global g = e
      end
      change(3)
      change(c=3, d=5)
      write_output_float_register(0, a)
      write_output_float_register(1, b)
      write_output_float_register(2, g)
    """
    assert result(body)[:3] == [21.0, 42.0, 8.0]


def test_lists_are_values() -> None:
    body = """
      a = [1, 2]
      b = a
      b[0] = 9
      write_output_float_register(0, a[0])
      write_output_float_register(1, b[0])
    """
    assert result(body)[:2] == [1.0, 9.0]


def test_threads_run_beside_one_another_until_they_end() -> None:
    body = """
      count = 0
      thread counting():
        while True:
          count = count + 1
          sync()
        end
      end
      handle = run counting()
      sleep(0.01)
      kill handle
      seen = count
      sleep(0.01)
      thread short():
        sleep(0.004)
      end
      join run short()
      write_output_float_register(0, seen)
      write_output_float_register(1, count - seen)
    """
    # A thread begins in the cycle after `run`.
    assert result(body, 40)[:2] == [4.0, 0.0]


def test_a_critical_section_lets_other_threads_run_where_it_waits() -> None:
    body = """
      turns = 0
      thread other():
        while True:
          turns = turns + 1
          sync()
        end
      end
      run other()
      sync()
      enter_critical
      before = turns
      sync()
      sync()
      write_output_float_register(0, turns - before)
      exit_critical
    """
    assert result(body)[0] == 2.0


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("def a():\n  while True:\n  end\nend", "infinite loop"),
        ("def a():\n  nothing(1)\nend", "'nothing' is not known"),
        ("def a():\n  x = y\nend", "'y' has no value"),
        ("def a():\n  x = [1][1]\nend", "line 2"),
        ("def a():\n  x = 1 / 0\nend", "line 2"),
        ("def a():\n  if 1 > 0:\nend", "expected 'end'"),
        ("def a():\n  x = (1\nend", "line 3"),
        ("def a():\n  speedj([1, 2], 1, 0.1)\nend", "six numbers"),
        ("def a():\n  speedj([0, 0, 0, 0, 0, 1 / 1e-400], 1, 0.1)\nend", "line 2"),
        ("def a():\n  servoj([0, 0, 0, 0, 0, 0], lookahead_time=0.01)\nend", "from 0.03 to 0.2"),
        ("def a():\n  servoc(p[0, 0, 0, 0, 0, 0])\nend", "servoc is not emulated"),
        ("def a():\n  x = tool_contact()\nend", "tool_contact is not emulated"),
        ("def a():\n  movej(p[9, 0, 0, 0, 0, 0])\nend", "no joint positions"),
        ("def a():\n  x = [1, 2] * [1, 2]\nend", "'*' of"),
        ("def a():\n  x = 1 / [1, 2]\nend", "'/' of"),
        ("def a():\n  socket_open('8.8.8.8', 80)\nend", "only loopback"),
        ("def a():\n  x = read_input_float_register(48)\nend", "from 0 to 47"),
        ("def a():\n  def f():\n   f()\n  end\n  f()\nend", "calls inside one another"),
        ("def a():\n  x = 2\n  while True:\n   x = x * x\n  end\nend", "overflows"),
        ("def a():\n  x = [1]\n  while True:\n   x = [x, x]\n  end\nend", "elements"),
        (
            "def a():\n thread t():\n speedj([0,0,0,0,0,0], 1, 1)\n end\n run t()\n run t()\n"
            " sleep(1)\nend",
            "already controlling",
        ),
        ("def a():\nend\ndef b():\nend", "2 programs"),
        ("def a():\n  x = " + "(" * 500 + "1" + ")" * 500 + "\nend", "inside one another"),
    ],
)
def test_what_the_controller_refuses_ends_the_program(script: str, said: str) -> None:
    controller = UrController()
    controller.run_script(script)
    settle(controller, 0.1)
    assert controller.runtime == Runtime.STOPPED
    assert said in controller.messages[-1]
    assert controller.motion.at_rest


def test_a_secondary_program_runs_beside_the_other_one() -> None:
    controller = UrController()
    assert controller.run_script("def a():\n while True:\n sync()\n end\nend")
    assert controller.run_secondary("sec b():\n set_standard_digital_out(2, True)\nend")
    assert controller.digital_outputs == 4
    assert controller.runtime == Runtime.PLAYING


def test_random_scripts_neither_hang_nor_raise_anything_else() -> None:
    generator = random.Random(6)
    words = (follow() + NOISE).split()
    refused = 0
    for _ in range(SCRIPTS):
        chosen = generator.choices(words, k=generator.randrange(1, 60))
        script = "def a():\n" + " ".join(chosen) + "\nend"
        if generator.random() < 0.3:
            lines = follow().splitlines()
            del lines[generator.randrange(len(lines))]
            script = "\n".join(lines)
        controller = UrController()
        try:
            machine = Machine(script, controller._builtins)
            for _ in range(3):
                machine.cycle()
        except ScriptError:
            refused += 1
    print(f"{SCRIPTS} scripts, {refused} refused")
    assert SCRIPTS / 2 < refused < SCRIPTS
