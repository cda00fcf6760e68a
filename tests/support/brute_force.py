"""Hard bodies by brute force: every pair, every image and every wall at each event, in NumPy. Slow and plain."""

import itertools

import numpy as np


def events(x, n, sides, diameter, mass, walls, count):
    """The first events: times (count,), names as `zoo.hard_disks` gives them, and the state after the last.

    x is (q₁, …, q_n, p₁, …, p_n). A flight is cut where a pair might leave the images that are looked at.
    """
    d, sides = len(sides), np.asarray(sides)
    q, p = np.array(x, float).reshape(2, n, d)
    diameter, mass = np.broadcast_to(diameter, n), np.broadcast_to(mass, n)
    first, second = np.triu_indices(n, 1)
    reach = (diameter[first] + diameter[second]) / 2
    shifts = [np.zeros(d)] if walls else [np.array(s) * sides for s in itertools.product((-2, -1, 0, 1, 2), repeat=d)]
    t, times, names = 0.0, [], []
    while len(times) < count:
        v = p / mass[:, None]
        apart, velocity = q[second] - q[first], v[second] - v[first]
        if not walls:
            apart = apart - sides * np.round(apart / sides)
        found = [_contact(apart + shift, velocity, reach) for shift in shifts]
        image, pair = np.unravel_index(np.argmin(found), np.shape(found))
        dt = found[image][pair]
        wall = _walls(q, v, sides, diameter) if walls else np.full((n, d), np.inf)
        if not walls:
            dt_safe = 0.5 * sides.min() / np.linalg.norm(velocity, axis=1).max()
            if dt > dt_safe:
                t, q = t + dt_safe, q + dt_safe * v
                continue
        if wall.min() < dt:
            body, axis = np.unravel_index(np.argmin(wall), wall.shape)
            dt = wall[body, axis]
            q = q + dt * v
            names.append(n * n + 2 * d * body + 2 * axis + int(v[body, axis] > 0))
            p[body, axis] *= -1
        else:
            a, b = first[pair], second[pair]
            q = q + dt * v
            normal = apart[pair] + shifts[image] + dt * velocity[pair]
            normal = normal / np.linalg.norm(normal)
            kick = 2 / (1 / mass[a] + 1 / mass[b]) * (velocity[pair] @ normal) * normal
            p[a] += kick
            p[b] -= kick
            names.append(n * a + b)
        t += dt
        times.append(t)
    return np.array(times), np.array(names), np.concatenate([q.ravel(), p.ravel()])


def _contact(apart, velocity, reach):
    """When each pair is as close as its reach."""
    approach, speed2 = np.sum(apart * velocity, axis=1), np.sum(velocity**2, axis=1)
    discriminant = approach**2 - speed2 * (np.sum(apart**2, axis=1) - reach**2)
    meets = (approach < 0) & (discriminant > 0)
    return np.where(meets, (-approach - np.sqrt(np.where(meets, discriminant, 0))) / np.where(meets, speed2, 1), np.inf)


def _walls(q, v, sides, diameter):
    """When each body meets the wall ahead, along each axis."""
    radius = diameter[:, None] / 2
    room = np.where(v > 0, sides - radius - q, q - radius)
    return np.where(v != 0, room / np.where(v == 0, 1, np.abs(v)), np.inf)
