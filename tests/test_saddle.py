"""Saddle-point solver: exact where the matrix allows it, also with free pressure constants."""

import numpy as np
from ngsolve import (
    H1,
    BilinearForm,
    GridFunction,
    InnerProduct,
    LinearForm,
    Mesh,
    VectorH1,
    div,
    dx,
    grad,
    unit_square,
    x,
    y,
)

from grainmesh.saddle import SaddleFactor


def test_solves_stokes_to_round_off_and_leaves_the_matrix_alone():
    mesh = Mesh(unit_square.GenerateMesh(maxh=0.2))
    V = VectorH1(mesh, order=3, dirichlet=".*")
    X = V * H1(mesh, order=2)
    (u, p), (v, q) = X.TnT()
    a = BilinearForm((InnerProduct(grad(u), grad(v)) - div(u) * q - div(v) * p) * dx).Assemble()
    f = LinearForm((y * v[0] - x * x * v[1]) * dx).Assemble().vec
    before = np.array(a.mat.AsVector())
    factor = SaddleFactor(a.mat, V.ndof, X.FreeDofs())
    flow = GridFunction(X)
    residual = factor.solve(f, flow.vec).FV().NumPy()
    assert np.array_equal(before, np.array(a.mat.AsVector()))
    free = np.asarray(X.FreeDofs())
    assert np.abs(residual[free]).max() < 1e-13
    assert np.abs(flow.vec.FV().NumPy()).max() > 1e-4


def test_gradient_forces_move_nothing():
    # f = grad(phi) with phi in the pressure space is balanced by the pressure alone.
    mesh = Mesh(unit_square.GenerateMesh(maxh=0.3))
    V = VectorH1(mesh, order=3, dirichlet=".*")
    X = V * H1(mesh, order=2)
    (u, p), (v, q) = X.TnT()
    a = BilinearForm((InnerProduct(grad(u), grad(v)) - div(u) * q - div(v) * p) * dx).Assemble()
    f = LinearForm((2 * x * v[0] + v[1]) * dx).Assemble().vec
    flow = GridFunction(X)
    SaddleFactor(a.mat, V.ndof, X.FreeDofs()).solve(f, flow.vec)
    assert np.abs(flow.components[0].vec.FV().NumPy()).max() < 1e-13
