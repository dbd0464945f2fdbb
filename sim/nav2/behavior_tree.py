"""A small behaviour-tree engine with the control nodes of Nav2's navigation tree.

Statuses, halting and memory follow BehaviorTree.CPP 3 and ``nav2_behavior_tree`` on Humble: a
child that is halted while it runs loses its progress, one that has ended only becomes idle. The
leaves, which act, are in ``behavior_tree_leaves``.
"""

import enum
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence


class NodeStatus(enum.Enum):
    """Status of a node after its last tick."""

    IDLE = enum.auto()
    RUNNING = enum.auto()
    SUCCESS = enum.auto()
    FAILURE = enum.auto()


class TreeNode(ABC):
    """A node of the tree.

    Parameters
    ----------
    name
        As it appears in the log.

    Attributes
    ----------
    on_change
        Called with the node, its previous and its new status at every change.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.status = NodeStatus.IDLE
        self.on_change: Callable[[TreeNode, NodeStatus, NodeStatus], None] = lambda *_: None

    def execute(self) -> NodeStatus:
        """Tick the node and keep the outcome as its status."""
        self.set_status(self.tick())
        return self.status

    def set_status(self, status: NodeStatus) -> None:
        """Change the status and call ``on_change``."""
        if status is not self.status:
            previous, self.status = self.status, status
            self.on_change(self, previous, status)

    def walk(self) -> Iterator["TreeNode"]:
        """Yield the node and all below it."""
        yield self

    @abstractmethod
    def tick(self) -> NodeStatus:
        """Do the node's work of one tick."""

    def halt(self) -> None:
        """Interrupt the node."""
        self.set_status(NodeStatus.IDLE)


class _ControlNode(TreeNode):
    """A node that ticks its children by some rule."""

    def __init__(self, name: str, children: Sequence[TreeNode]) -> None:
        super().__init__(name)
        self.children = children
        self.forget()

    def walk(self) -> Iterator[TreeNode]:
        """Yield the node and all below it."""
        yield self
        for child in self.children:
            yield from child.walk()

    def forget(self) -> None:
        """Start from the beginning next time."""

    def halt(self) -> None:
        """Interrupt the node and its children, and start from the beginning next time."""
        self.end_tick()
        super().halt()

    def end_tick(self) -> None:
        """Make all children idle, and start from the beginning next time."""
        self.halt_children()
        self.forget()

    def halt_child(self, child: TreeNode) -> None:
        """Interrupt a child if it runs, and make it idle."""
        if child.status is NodeStatus.RUNNING:
            child.halt()
        child.set_status(NodeStatus.IDLE)

    def halt_children(self) -> None:
        """Interrupt every child that runs, and make all idle."""
        for child in self.children:
            self.halt_child(child)


class SequenceNode(_ControlNode):
    """Ticks its children one after the other until one fails."""

    def forget(self) -> None:
        """Start from the first child next time."""
        self._current = 0

    def tick(self) -> NodeStatus:
        """Continue with the current child."""
        self.set_status(NodeStatus.RUNNING)
        while self._current < len(self.children):
            status = self.children[self._current].execute()
            if status is NodeStatus.RUNNING:
                return status
            if status is NodeStatus.FAILURE:
                self.end_tick()
                return status
            self._current += 1
        self.end_tick()
        return NodeStatus.SUCCESS


class PipelineSequence(_ControlNode):
    """A sequence that ticks the children before the running one again in every tick."""

    def forget(self) -> None:
        """Start an empty pipeline next time."""
        self._furthest = 0

    def tick(self) -> NodeStatus:
        """Tick from the first child to the one that the pipeline has reached."""
        for index, child in enumerate(self.children):
            status = child.execute()
            if status is NodeStatus.FAILURE:
                self.end_tick()
                return status
            if status is NodeStatus.RUNNING and index >= self._furthest:
                self._furthest = index
                return status
        self.end_tick()
        return NodeStatus.SUCCESS


class RecoveryNode(_ControlNode):
    """Ticks its first child; when that fails, the second one, and then the first again.

    Parameters
    ----------
    name, child, recovery
        The child to tick, and the one to tick when it fails.
    retries
        Largest number of recoveries.
    """

    def __init__(self, name: str, child: TreeNode, recovery: TreeNode, retries: int) -> None:
        super().__init__(name, (child, recovery))
        self._retries = retries

    def forget(self) -> None:
        """Have all retries left next time."""
        self._tries = 0
        self._recovering = False

    def tick(self) -> NodeStatus:
        """Tick the child, or the recovery after a failure."""
        self.set_status(NodeStatus.RUNNING)
        child, recovery = self.children
        while True:
            node = recovery if self._recovering else child
            status = node.execute()
            if status is NodeStatus.RUNNING:
                return status
            if self._recovering:
                is_over = status is NodeStatus.FAILURE
            else:
                is_over = status is NodeStatus.SUCCESS or self._tries >= self._retries
            if is_over:
                self.halt()
                return status
            self.halt_child(node)
            if self._recovering:
                self._tries += 1
            self._recovering = not self._recovering


class ReactiveFallback(_ControlNode):
    """Ticks its children from the first on in every tick until one does not fail."""

    def tick(self) -> NodeStatus:
        """Find a child that succeeds or runs."""
        for child in self.children:
            status = child.execute()
            if status is NodeStatus.RUNNING:
                return status
            if status is NodeStatus.SUCCESS:
                break
        self.halt_children()
        return status


class RoundRobin(_ControlNode):
    """Ticks one child until it ends, and the next one in a later tick.

    It keeps its position after a success, so the next failure leads to the next recovery.
    """

    def forget(self) -> None:
        """Start with the first child next time."""
        self._current = 0
        self._failed = 0

    def tick(self) -> NodeStatus:
        """Continue with the current child, and skip those that fail."""
        self.set_status(NodeStatus.RUNNING)
        while self._failed < len(self.children):
            status = self.children[self._current].execute()
            if status is NodeStatus.RUNNING:
                return status
            self._current = (self._current + 1) % len(self.children)
            if status is NodeStatus.SUCCESS:
                self._failed = 0
                self.halt_children()
                return status
            self._failed += 1
        self.halt()
        return NodeStatus.FAILURE


class RateController(_ControlNode):
    """Ticks its child at once, then once a period; a running child in every tick.

    Parameters
    ----------
    child
        The only one.
    period_ns
        From one success of the child to its next tick.
    now_ns
        The clock.
    wake_at
        Requests a tick of the tree at a time [ns].
    """

    def __init__(
        self,
        child: TreeNode,
        period_ns: int,
        now_ns: Callable[[], int],
        wake_at: Callable[[int], None],
    ) -> None:
        super().__init__("RateController", (child,))
        self._period_ns = period_ns
        self._now_ns = now_ns
        self._wake_at = wake_at
        self._due_ns = 0

    def tick(self) -> NodeStatus:
        """Tick the child if it is due."""
        if self.status is NodeStatus.IDLE:
            self._due_ns = self._now_ns()
        self.set_status(NodeStatus.RUNNING)
        (child,) = self.children
        if child.status is NodeStatus.RUNNING or self._now_ns() >= self._due_ns:
            status = child.execute()
            if status is not NodeStatus.SUCCESS:
                return status
            self._due_ns = self._now_ns() + self._period_ns
            self._wake_at(self._due_ns)
            return status
        return NodeStatus.RUNNING
