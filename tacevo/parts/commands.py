"""Our commands: by group, where each is and its line in the help."""

from collections.abc import Mapping

#: By group and name: `module:attribute` of what describes its arguments, and what it does. Its module is imported when
#: the command is given, so that the help is quick.
GROUPS: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "search": {
        "search": ("tacevo.cli.search:add_search", "run a search or a sweep, or continue one that was stopped"),
        "extend": ("tacevo.cli.arguments:add_extend", "search on from the end of a published run"),
        "study": (
            "tacevo.cli.arguments:add_study",
            "train a run's best networks and the baseline fully, with many seeds, and test them",
        ),
        "noise": (
            "tacevo.cli.arguments:add_noise",
            "train a run's elites again with other seeds, to see how much of each fitness was luck",
        ),
        "tabulate": (
            "tacevo.cli.arguments:add_tabulate",
            "train every network of a closed space, for searches that look evaluations up",
        ),
        "plan": (
            "tacevo.cli.arguments:add_plan",
            "compute how many seeds are needed to detect an effect of a given size, and the cost",
        ),
    },
    "reproduce": {
        "replay": ("tacevo.cli.arguments:add_replay", "run a recorded search again from its stores and compare"),
        "export": ("tacevo.cli.arguments:add_export", "take a network away: its weights, ONNX, a model card"),
        "publish": (
            "tacevo.cli.arguments:add_publish",
            "write one file with which anybody can replay a run or a sweep",
        ),
        "cache": (
            "tacevo.cli.cache:add_cache",
            "look into the stores of answers, move what a run needs, remove what none does",
        ),
    },
    "analyse": {
        "show": (
            "tacevo.cli.arguments:add_show",
            "show what a run found, one candidate of it, or how far the jobs of a sweep are",
        ),
        "tables": (
            "tacevo.cli.arguments:add_tables",
            "write every table of runs and sweeps, those that a paper needs first",
        ),
        "figures": ("tacevo.cli.arguments:add_figures", "draw every figure of runs and sweeps, for a paper"),
        "report": (
            "tacevo.cli.arguments:add_report",
            "write one page to look into a run or a sweep, or a LaTeX document of several",
        ),
        "ablations": ("tacevo.cli.arguments:add_ablations", "compare the arms of a sweep: tables and figures"),
    },
    "tools": {
        "init": ("tacevo.cli.init:add_init", "write a task of your own, copied from another one, to be edited"),
        "data": ("tacevo.cli.data:add_data", "look at a data set, or write a simulated one as files"),
        "check": ("tacevo.cli.inspect:add_check", "put raw answers of a model through the gate"),
        "parts": ("tacevo.cli.parts:add_parts", "list what can be plugged in, and check a part of your own"),
        "track": (
            "tacevo.cli.track:add_track",
            "write the ledgers of runs into MLflow, or what is missing of them there",
        ),
        "doctor": ("tacevo.cli.inspect:add_doctor", "check whether this machine has what a run needs"),
    },
}

#: Where each is.
PLACES = {name: place for group in GROUPS.values() for name, (place, _) in group.items()}

#: What each does.
LINES = {name: line for group in GROUPS.values() for name, (_, line) in group.items()}
