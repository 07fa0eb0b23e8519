"""Steps of MuJoCo whose noslip pass is ours: the same forces in less time.

MuJoCo's own pass writes down the matrix of all constraints, and its solver starts the next step from
accelerations that the pass has changed.
Here the engine steps without its pass, `noslip_kernels` computes it, and the solver starts from
where it ended: `data.qacc` and `data.efc_force` stay those before the pass.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bidexdata.devices import start_warp

if TYPE_CHECKING:
    import mujoco

CONDIM = 4
"""Dimension of the contacts that the pass knows: normal, two of sliding, spinning."""
_ROOM = 1.5
"""Buffers that are too small grow to this multiple of what is needed."""


class NoslipSteps:
    """Steps of one scene; holds buffers and a recorded launch."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._data = model, data
        self._iterations = 0
        self._sizes = (0, 0, 0)
        self._buffers: dict[str, Any] = {}
        self._launch: Any = None

    def applies(self) -> bool:
        """Whether the engine would run the pass, and ours knows all kinds of rows in it."""
        import mujoco

        model, opt = self._model, self._model.opt
        return bool(
            opt.noslip_iterations > 0
            and opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
            and opt.solver == mujoco.mjtSolver.mjSOL_NEWTON
            and opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
            and mujoco.mj_isSparse(model)
            and (model.geom_condim == CONDIM).all()
            and model.npair == 0
            and model.nsensor == 0
        )

    def step(self, steps: int) -> None:
        """Advance by a number of steps, as `mujoco.mj_step` does."""
        import mujoco

        model, data = self._model, self._data
        iterations = int(model.opt.noslip_iterations)
        model.opt.noslip_iterations = 0
        try:
            for _ in range(steps):
                mujoco.mj_checkPos(model, data)
                mujoco.mj_checkVel(model, data)
                mujoco.mj_fwdPosition(model, data)
                mujoco.mj_fwdVelocity(model, data)
                mujoco.mj_fwdActuation(model, data)
                mujoco.mj_fwdAcceleration(model, data)
                mujoco.mj_fwdConstraint(model, data)
                mujoco.mj_checkAcc(model, data)
                self.correct(iterations)
                mujoco.mj_implicit(model, data)
        finally:
            model.opt.noslip_iterations = iterations

    def correct(self, iterations: int) -> None:
        """Change `data.qfrc_constraint` by what the pass changes, after `mj_fwdConstraint`.

        Args:
            iterations: Of the pass; the model's own number may be 0 while the engine steps.
        """
        data = self._data
        if iterations != self._iterations:  # the recorded launch is of another number
            self._iterations, self._sizes = iterations, (0, 0, 0)
        rows, entries, contacts = data.nefc, len(data.efc_J), data.ncon
        if rows > self._sizes[0] or entries > self._sizes[1] or contacts > self._sizes[2]:
            self._allocate(rows, entries, contacts)
        b = self._buffers
        b["sizes"][:] = data.ne, data.nf, rows, contacts
        b["values"][:] = data.qLD
        b["inverse_diagonal"][:] = data.qLDiagInv
        b["jacobian"][:entries] = data.efc_J
        b["column"][:entries] = data.efc_J_colind
        b["start"][:rows] = data.efc_J_rowadr
        b["count"][:rows] = data.efc_J_rownnz
        b["bias"][:rows] = data.efc_b
        b["regulariser"][:rows] = data.efc_R
        b["friction_loss"][:rows] = data.efc_frictionloss
        b["force"][:rows] = data.efc_force
        if contacts:
            contact = data.contact
            b["contact_row"][:contacts] = contact.efc_address
            b["contact_friction"][:contacts] = contact.friction
        b["qfrc_in"][:] = data.qfrc_constraint
        self._launch.launch()
        data.qfrc_constraint[:] = b["qfrc_out"]

    def _allocate(self, rows: int, entries: int, contacts: int) -> None:
        """Make buffers, which numpy and Warp share, and record the launch on them."""
        start_warp()
        import warp as wp

        from .noslip_kernels import Factor, Rows, Scratch, noslip

        model = self._model
        nv = model.nv
        rows, entries, contacts = (int(_ROOM * n) + 16 for n in (rows, entries, contacts))
        self._sizes = (rows, entries, contacts)
        self._buffers = buffers = {}

        def shared(name: str, shape: int | tuple[int, ...], dtype: type = np.float64) -> Any:
            buffers[name] = np.zeros(shape, dtype)
            return wp.array(buffers[name], copy=False, device="cpu")

        def room(shape: int | tuple[int, ...], dtype: Any) -> Any:
            return wp.zeros(shape, dtype=dtype, device="cpu")

        M = Factor()
        M.values = shared("values", model.nC)
        M.inverse_diagonal = shared("inverse_diagonal", nv)
        M.start = wp.array(model.M_rowadr, dtype=wp.int32, device="cpu")
        M.count = wp.array(model.M_rownnz, dtype=wp.int32, device="cpu")
        M.column = wp.array(model.M_colind, dtype=wp.int32, device="cpu")
        r = Rows()
        r.sizes = shared("sizes", 4, np.int32)
        r.jacobian = shared("jacobian", entries)
        r.column = shared("column", entries, np.int32)
        r.start = shared("start", rows, np.int32)
        r.count = shared("count", rows, np.int32)
        r.bias = shared("bias", rows)
        r.regulariser = shared("regulariser", rows)
        r.friction_loss = shared("friction_loss", rows)
        r.force = shared("force", rows)
        r.contact_row = shared("contact_row", contacts, np.int32)
        r.contact_friction = shared("contact_friction", (contacts, 5))
        s = Scratch()
        s.loss = room((rows, nv), wp.float64)
        s.loss_dof = room((rows, nv), wp.int32)
        s.loss_count = room(rows, wp.int32)
        s.loss_square = room(rows, wp.float64)
        s.block = room((contacts, nv), wp.vec3d)
        s.block_dof = room((contacts, nv), wp.int32)
        s.block_count = room(contacts, wp.int32)
        s.block_square = room(contacts, wp.mat33d)
        s.lane = room(nv, wp.vec3d)
        s.marked = room(nv, wp.int32)
        s.y = room(nv, wp.float64)
        cost = model.stat.meaninertia * max(1, nv)
        self._launch = wp.launch(
            noslip,
            dim=1,
            inputs=[
                *(nv, self._iterations, model.opt.noslip_tolerance * cost, M, r),
                *(shared("qfrc_in", nv), s, room(rows, wp.float64), shared("qfrc_out", nv)),
            ],
            device="cpu",
            record_cmd=True,
        )
