"""Prints the nodes, includes, arguments and environment of a launch file as JSON.

Usage: describe.py FILE.launch.py [ARGUMENT:=VALUE ...]

`launch` and `launch_ros` are not on PyPI, so stand-ins replace them here. The stand-ins accept the arguments of the real
classes that our files use and refuse all others. Use of an undeclared launch argument is an error.
"""

import json
import runpy
import sys
from types import ModuleType

declared = {}  # name -> default
given = {}  # name -> value
result = {"arguments": {}, "nodes": [], "includes": [], "environment": {}}


class Context:
    """Launch context; passed to `perform` and OpaqueFunction."""


def text(value, context=None):
    """Returns the text of a substitution or of a list of substitutions."""
    if isinstance(value, (list, tuple)):
        return "".join(text(part, context) for part in value)
    return value.perform(context) if hasattr(value, "perform") else str(value)


class LaunchConfiguration:
    def __init__(self, name, default=None):
        self.name, self.default = name, default

    def perform(self, context):
        if self.name not in declared:
            sys.exit(f"the argument {self.name!r} is used but not declared")
        return text(given.get(self.name, declared[self.name]), context)


class FindPackageShare:
    def __init__(self, package):
        self.package = package

    def perform(self, context):
        return f"<share of {self.package}>"


class PathJoinSubstitution:
    def __init__(self, parts):
        self.parts = parts

    def perform(self, context):
        return "/".join(text(part, context) for part in self.parts)


class PythonLaunchDescriptionSource:
    def __init__(self, location):
        self.location = location


class IfCondition:
    def __init__(self, predicate):
        self.predicate = predicate

    def evaluate(self, context):
        value = text(self.predicate, context).strip().lower()
        if value not in ("true", "1", "false", "0"):
            sys.exit(f"a condition is neither true nor false: {value!r}")
        return value in ("true", "1")


class Action:
    def __init__(self, *, condition=None):
        self.condition = condition

    def visit(self, context):
        if self.condition is None or self.condition.evaluate(context):
            for action in self.execute(context) or []:
                action.visit(context)


class DeclareLaunchArgument(Action):
    def __init__(self, name, *, default_value=None, description=None, choices=None, **options):
        super().__init__(**options)
        self.name, self.default, self.description, self.choices = name, default_value, description, choices

    def execute(self, context):
        if self.default is None and self.name not in given:
            sys.exit(f"the argument {self.name!r} has no default")
        declared[self.name] = self.default
        default = text(self.default, context)
        result["arguments"][self.name] = {"default": default, "description": self.description}


class OpaqueFunction(Action):
    def __init__(self, *, function, args=(), kwargs=None, **options):
        super().__init__(**options)
        self.function, self.args, self.kwargs = function, args, kwargs or {}

    def execute(self, context):
        return self.function(context, *self.args, **self.kwargs)


class SetEnvironmentVariable(Action):
    def __init__(self, name, value, **options):
        super().__init__(**options)
        self.name, self.value = name, value

    def execute(self, context):
        result["environment"][text(self.name, context)] = text(self.value, context)


class IncludeLaunchDescription(Action):
    def __init__(self, source, *, launch_arguments=(), **options):
        super().__init__(**options)
        self.source, self.arguments = source, launch_arguments

    def execute(self, context):
        arguments = {text(name, context): text(value, context) for name, value in self.arguments}
        result["includes"].append({"file": text(self.source.location, context), "arguments": arguments})
        # As in launch, the arguments of an include stay set for the actions behind it.
        given.update(arguments)


class Node(Action):
    def __init__(
        self, *, package, executable, name=None, namespace=None, parameters=(), remappings=(), arguments=(),
        output=None, prefix=None, sigterm_timeout="5", sigkill_timeout="5", **options,
    ):
        super().__init__(**options)
        self.package, self.executable, self.name, self.namespace = package, executable, name, namespace
        self.parameters, self.remappings, self.arguments, self.output = parameters, remappings, arguments, output
        self.prefix = prefix
        self.timeouts = [sigterm_timeout, sigkill_timeout]

    def execute(self, context):
        result["nodes"].append(
            {
                "package": text(self.package, context),
                "executable": text(self.executable, context),
                "name": text(self.name, context),
                "namespace": text(self.namespace or "", context),
                "parameter_files": [text(p, context) for p in self.parameters if not isinstance(p, dict)],
                "parameters": {k: v for p in self.parameters if isinstance(p, dict) for k, v in p.items()},
                "remappings": {text(a, context): text(b, context) for a, b in self.remappings},
                "prefix": text(self.prefix or "", context),
                "arguments": [text(argument, context) for argument in self.arguments],
                "timeouts": [float(text(timeout, context)) for timeout in self.timeouts],
            }
        )


class LaunchDescription:
    def __init__(self, actions):
        self.actions = actions


def stand_in(name, **members):
    """Makes the module `name` importable."""
    module = ModuleType(name)
    module.__dict__.update(members)
    sys.modules[name] = module


def main():
    stand_in("launch", LaunchDescription=LaunchDescription)
    actions = [DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction, SetEnvironmentVariable]
    stand_in("launch.actions", **{action.__name__: action for action in actions})
    stand_in("launch.conditions", IfCondition=IfCondition)
    stand_in("launch.launch_description_sources", PythonLaunchDescriptionSource=PythonLaunchDescriptionSource)
    stand_in(
        "launch.substitutions", LaunchConfiguration=LaunchConfiguration, PathJoinSubstitution=PathJoinSubstitution
    )
    stand_in("launch_ros")
    stand_in("launch_ros.actions", Node=Node)
    stand_in("launch_ros.substitutions", FindPackageShare=FindPackageShare)

    given.update(argument.split(":=", 1) for argument in sys.argv[2:])
    asked = set(given)
    description = runpy.run_path(sys.argv[1])["generate_launch_description"]()
    for action in description.actions:
        action.visit(Context())
    unknown = asked - declared.keys()
    if unknown:
        sys.exit(f"no such argument: {', '.join(sorted(unknown))}")
    json.dump(result, sys.stdout, indent=1)


main()
