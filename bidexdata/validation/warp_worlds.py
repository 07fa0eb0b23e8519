"""Worlds: many copies of one scene that MuJoCo Warp steps together on one device.

A world is a row of every array. Rows never touch each other, but they share the buffers of
contacts, so an overflow anywhere spoils all of them and is an error here. Numbers are float32.
Quaternions stay wxyz: MuJoCo Warp keeps them so inside `wp.quat`.
"""

from __future__ import annotations

import importlib
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.devices import check_device, start_warp
from bidexdata.errors import BidexError, MissingExtra, NotUsable
from bidexdata.simulation.scene import SimScene

from .protocols import Engine

CONTACTS = 64
"""Contacts a world has room for at first. Measured: at most 45 in one world, and on average over a
batch at most 32 contacts and 34 pairs of the broad phase (docs/mujoco_warp.md)."""
MOST_CONTACTS = 1024
"""Room for contacts a world may grow to."""

FloatArray = NDArray[np.float64]
RowArray = NDArray[np.float32]
IntArray = NDArray[np.intp]


class ContactOverflow(BidexError):
    """A world has more contacts than the largest buffers hold; no verdict of its batch counts."""

    def __init__(self, contacts: int, what: str):
        self.contacts, self.what = contacts, what
        super().__init__(
            f"MuJoCo Warp ran out of room for contacts ({what}) with {contacts} a world; judge "
            "these grasps with the C engine, or give the object fewer convex pieces"
        )


class WorldState(NamedTuple):
    """What one step hands to the next, and the load, of N worlds; float32."""

    qpos: RowArray
    """(N, nq)."""
    qvel: RowArray
    """(N, nv)."""
    qacc_warmstart: RowArray
    """Where the solver starts, (N, nv)."""
    ctrl: RowArray
    """(N, nu)."""
    mocap_pos: RowArray
    """(N, nmocap, 3) [m]."""
    mocap_quat: RowArray
    """(N, nmocap, 4)."""
    gravity: RowArray
    """(N, 3) [m/s^2]."""

    def rows(self, which: IntArray) -> WorldState:
        """The named rows."""
        return WorldState(*(a[which] for a in self))


def load_engine() -> Any:
    """Import MuJoCo Warp.

    Raises:
        MissingExtra: It is not installed.
    """
    start_warp()
    try:
        return importlib.import_module("mujoco_warp")
    except ImportError as err:
        raise MissingExtra("mujoco-warp", "gpu") from err


def engine_identity(device: str) -> Engine:
    """Say what the verdicts of this engine on a device are marked with.

    Raises:
        MissingExtra: MuJoCo Warp is not installed.
        NotUsable: There is no such device.
    """
    engine = load_engine()
    check_device(device)
    import warp as wp

    kind = "cuda" if wp.get_device(device).is_cuda else "cpu"
    return Engine(device=kind, mujoco_warp=engine.__version__, warp=wp.__version__)


class Worlds:
    """A fixed number of worlds of one scene; they all step at once."""

    def __init__(self, scene: SimScene, parked: WorldState, count: int, contacts: int, device: str):
        """Allocate, and compile or load the kernels.

        Args:
            scene: Its compiled model is copied to the device.
            parked: One row; the state of worlds that nobody uses. It should be a calm one: a
                world in trouble slows the solver of all.
            count: Number of worlds.
            contacts: Contacts that there is room for, per world.
            device: Warp device.

        Raises:
            MissingExtra: MuJoCo Warp is not installed.
            NotUsable: There is no such device, or the engine lacks a feature of the scene.
        """
        self._engine = load_engine()
        import warp as wp

        self._scene, self.count, self._contacts = scene, count, contacts
        self._parked, self._graph = parked, None
        check_device(device)
        self._device = wp.get_device(device)
        with wp.ScopedDevice(self._device):
            try:
                self._model = self._engine.put_model(scene.model)
            except NotImplementedError as err:
                raise NotUsable(f"MuJoCo Warp cannot simulate this scene: {err}") from err
            self._model.opt.warn_overflow = 0  # this class reads the flags instead
            self._model.opt.gravity = wp.zeros(count, dtype=wp.vec3)
            self._data = self._engine.make_data(
                scene.model,
                nworld=count,
                nconmax=contacts,
                njmax=constraint_rows(scene, contacts),
            )
            self.park(np.arange(count))
            self._engine.step(self._model, self._data)  # kernels must be loaded before a capture
            if self._device.is_cuda:
                with wp.ScopedCapture() as capture:
                    self._engine.step(self._model, self._data)
                self._graph = capture.graph
            self._data.overflow.zero_()
        self.park(np.arange(count))

    def write(self, rows: IntArray, state: WorldState) -> None:
        """Overwrite the state of some worlds, one row of `state` each."""
        for name, values in state._asdict().items():
            array = self._array(name)
            host = np.array(array.numpy())
            host[rows] = values
            array.assign(host)

    def park(self, rows: IntArray) -> None:
        """Put some worlds into the calm state."""
        self.write(rows, self._parked.rows(np.zeros(len(rows), np.intp)))

    def aim(self, mocap_pos: FloatArray, mocap_quat: FloatArray, ctrl: FloatArray) -> None:
        """Give new targets to the first worlds: (N, H, 3), (N, H, 4), (N, nu)."""
        for name, values in (
            ("mocap_pos", mocap_pos),
            ("mocap_quat", mocap_quat),
            ("ctrl", ctrl),
        ):
            array = self._array(name)
            host = np.array(array.numpy())
            host[: len(values)] = values
            array.assign(host)

    def read(self, rows: IntArray) -> WorldState:
        """The state of some worlds."""
        return WorldState(*(np.array(self._array(n).numpy()[rows]) for n in WorldState._fields))

    def motion(self, rows: IntArray) -> tuple[FloatArray, FloatArray]:
        """Positions (N, nq) and velocities (N, nv) of some worlds."""
        qpos, qvel = self._data.qpos.numpy(), self._data.qvel.numpy()
        return qpos[rows].astype(np.float64), qvel[rows].astype(np.float64)

    def step(self, steps: int) -> None:
        """Step all worlds.

        Raises:
            ContactOverflow: A buffer was too small.
        """
        import warp as wp

        with wp.ScopedDevice(self._device):
            for _ in range(steps):
                if self._graph is None:
                    self._engine.step(self._model, self._data)
                else:
                    wp.capture_launch(self._graph)
        kinds = self._engine.OverflowType
        flags = int(np.bitwise_or.reduce(self._data.overflow.numpy()))
        spoiling = (kinds.NEFC, kinds.NJMAX_NNZ, kinds.BROADPHASE, kinds.NARROWPHASE, kinds.CCD)
        found = [kind.name.lower() for kind in spoiling if flags & kind]
        self._data.overflow.zero_()
        if found:
            raise ContactOverflow(self._contacts, ", ".join(found))

    def touching(self) -> NDArray[np.bool_]:
        """Whether a hand was in contact with the object in the last step, (count,)."""
        contact, number = self._data.contact, int(self._data.nacon.numpy()[0])
        geoms = contact.geom.numpy()[:number].reshape(-1, 2)
        owners = self._scene.geom_owner[geoms]
        of_object = owners == self._scene.object_owner
        by_hand = (owners >= 0) & ~of_object
        hit = of_object.any(axis=1) & by_hand.any(axis=1) & (contact.dist.numpy()[:number] < 0)
        touched = np.zeros(self.count, bool)
        touched[contact.worldid.numpy()[:number][hit]] = True
        return touched

    def _array(self, name: str) -> Any:
        return self._model.opt.gravity if name == "gravity" else getattr(self._data, name)


def constraint_rows(scene: SimScene, contacts: int) -> int:
    """Constraint rows that a world can have at most with so many contacts."""
    import mujoco

    model = scene.model
    per_weld = 6 * int((model.eq_type == mujoco.mjtEq.mjEQ_WELD).sum())
    friction = int((model.dof_frictionloss > 0).sum() + (model.tendon_frictionloss > 0).sum())
    limits = int(model.jnt_limited.sum() + model.tendon_limited.sum())
    condim = scene.settings.condim
    rows = condim if scene.settings.elliptic or condim == 1 else 2 * (condim - 1)
    return per_weld + friction + limits + rows * contacts
