"""Progress of a run: a bar, or a function of the fraction done."""

import warnings

__all__ = ["reporter"]


def reporter(progress, total: int = 100, unit: str = "%"):
    """A function to call with the fraction done, and with None at the end.

    `progress`: None for no report, True for a bar, or the user's function of the fraction done.
    """
    if progress is None or progress is False:
        return lambda fraction: None
    if callable(progress):
        return lambda fraction: None if fraction is None else progress(fraction)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # in a notebook without ipywidgets the bar is text
        from tqdm.auto import tqdm

    rate = "" if unit == "%" else ", {rate_fmt}"
    bar = tqdm(total=total, unit=unit, bar_format=f"{{l_bar}}{{bar}}| {{elapsed}}<{{remaining}}{rate}")

    def report(fraction):
        if fraction is None:
            bar.close()
        else:
            bar.update(round(total * fraction) - bar.n)

    return report
