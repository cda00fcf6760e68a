"""The same models by SciPy, written from the definition of SBML alone: conditions are remembered as true or false."""

import re

import numpy as np
from scipy.integrate import solve_ivp

TIGHT = {"method": "DOP853", "rtol": 1e-12, "max_step": 0.1}


def _expression(text: str):
    """(quantities by name and time) -> number, of a text such as "4 time" or "S2 + 1"."""
    code = compile(re.sub(r"([\d.]) ([A-Za-z])", r"\1 * \2", text), "model", "eval")
    return lambda names: eval(code, {"__builtins__": {}}, names)


def _comparison(text: str):
    left, sign, right = re.fullmatch(r"(.*?)([<>]=?)(.*)", text).groups()
    larger, smaller = (left, right) if sign[0] == ">" else (right, left)
    return _expression(f"({larger}) - ({smaller})".replace("( ", "(").replace(" )", ")")), "=" in sign


def _change(reactions, names):
    rules = []
    for reaction in reactions:
        factor, left, right = re.fullmatch(r"(.*):(.*)->(.*)", reaction).groups()
        change, reactants = np.zeros(len(names)), []
        for sign, side in ((-1, left), (1, right)):
            for term in filter(None, (term.strip() for term in side.split("+"))):
                number, name = re.fullmatch(r"(\d* ?)(\w+)", term).groups()
                change[names.index(name)] += sign * float(number or 1)
                reactants += [names.index(name)] if sign < 0 else []
        rules.append((float(factor), reactants, change))

    def field(t, x):
        return sum((k * np.prod(x[reactants]) * change for k, reactants, change in rules), np.zeros(len(x)))

    return field


class _Run:
    """One model on its way: quantities, what its conditions were, what is to be done and when."""

    def __init__(self, model):
        self.names, self.events = list(model.start), model.events
        self.field = _change(model.reactions, self.names)
        self.conditions = [[_comparison(part) for part in event.trigger.split(" and ")] for event in self.events]
        self.assign = [{k: _expression(v) for k, v in event.assign.items()} for event in self.events]
        self.t, self.x = 0.0, np.array(list(model.start.values()), float)
        self.holds = [[self._holds(c) for c in parts] for parts in self.conditions]
        self.was = [all(h) if event.initially else False for event, h in zip(self.events, self.holds, strict=True)]
        self.pending = []  # (due, number of the event, values)
        self.settle()

    def at(self, t, x):
        return dict(zip(self.names, x, strict=True)) | {"time": t}

    def _holds(self, condition):
        margin, closed = condition
        value = margin(self.at(self.t, self.x))
        return bool(value >= 0 if closed else value > 0)

    def values(self, i):
        return {name: value(self.at(self.t, self.x)) for name, value in self.assign[i].items()}

    def settle(self):
        """Trigger what has become true, cancel what is no longer, carry out the first that is due; again."""
        while True:
            for i, event in enumerate(self.events):
                now = all(self.holds[i])
                if now and not self.was[i]:
                    self.pending.append((self.t + event.delay, i, self.values(i)))
                if self.was[i] and not now and not event.persistent:
                    self.pending = [entry for entry in self.pending if entry[1] != i]
                self.was[i] = now
            due = [entry for entry in self.pending if entry[0] <= self.t + 1e-13]
            if not due:
                return
            entry = min(due, key=lambda entry: entry[1])  # events stand by falling priority
            self.pending.remove(entry)
            i = entry[1]
            before = self.x.copy()
            for name, value in (entry[2] if self.events[i].at_trigger else self.values(i)).items():
                self.x[self.names.index(name)] = value
            changed = [name for name, old, new in zip(self.names, before, self.x, strict=True) if old != new]
            for k, event in enumerate(self.events):
                if any(re.search(rf"\b{name}\b", event.trigger) for name in changed):
                    self.holds[k] = [self._holds(c) for c in self.conditions[k]]

    def flow(self, end):
        """To the next change of a condition, the next thing due or the end, whichever comes first."""
        stop = min([end] + [entry[0] for entry in self.pending])
        if stop > self.t:
            guards = [(i, j) for i, parts in enumerate(self.conditions) for j in range(len(parts))]
            functions = [self._guard(i, j) for i, j in guards]
            scale = np.max(np.abs(self.x)) or 1.0
            part = solve_ivp(self.field, (self.t, stop), self.x, events=functions, atol=1e-14 * scale, **TIGHT)
            self.t, self.x = part.t[-1], part.y[:, -1].copy()
            for (i, j), roots in zip(guards, part.t_events, strict=True):
                if len(roots):
                    self.holds[i][j] = not self.holds[i][j]
        self.settle()

    def _guard(self, i, j):
        def margin(t, x):
            return self.conditions[i][j][0](self.at(t, x))

        margin.terminal, margin.direction = True, -1.0 if self.holds[i][j] else 1.0
        return margin


def table(model, times) -> np.ndarray:
    """(times, quantities) of a model."""
    run, rows = _Run(model), []
    for end in times:
        while run.t < end:
            run.flow(end)
        rows.append(run.x.copy())
    return np.array(rows)
