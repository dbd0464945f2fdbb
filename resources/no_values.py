"""No values between assets: they pass files through the run store.

Dagster's own IO manager pickles values into a folder that a run's config may name, and unpickles
what it finds there.
"""

import dagster as dg


class NoValues(dg.ConfigurableIOManager):
    """Refuse to keep or to load a value of an asset."""

    def handle_output(self, context: dg.OutputContext, obj: object) -> None:
        """Accept the end of a step that returns nothing."""
        if obj is not None:
            raise dg.DagsterInvariantViolationError(
                f"{context.get_identifier()} returns a value. Write it to the run store instead."
            )

    def load_input(self, context: dg.InputContext) -> None:
        """Refuse: nothing was kept."""
        raise dg.DagsterInvariantViolationError(
            f"{context.name} asks for the value of an asset. Read it from the run store instead."
        )
