"""An IO manager that rejects values: assets pass files through the run store.

Dagster's default IO manager pickles values into a folder that the run config can choose, and
unpickles any file there.
"""

import dagster as dg


class NoValues(dg.ConfigurableIOManager):
    """Rejects storing and loading values of assets."""

    def handle_output(self, context: dg.OutputContext, obj: object) -> None:
        """Accept None only."""
        if obj is not None:
            raise dg.DagsterInvariantViolationError(
                f"{context.get_identifier()} returns a value. Write it to the run store instead."
            )

    def load_input(self, context: dg.InputContext) -> None:
        """Raise an error: no values are stored."""
        raise dg.DagsterInvariantViolationError(
            f"{context.name} requests the value of an asset. Read it from the run store instead."
        )
