CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE mesh (
  id INTEGER PRIMARY KEY CHECK (id = 0),
  nodes_m BLOB NOT NULL,      -- f64 x, y, z per node
  tets BLOB NOT NULL,         -- u32 x 4 per tetrahedron
  fixed BLOB NOT NULL,        -- u32 per fixed node
  groups TEXT NOT NULL        -- JSON: named groups of nodes, and of tetrahedra
);
CREATE TABLE active (id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, node INTEGER NOT NULL);
CREATE TABLE configuration (
  active INTEGER NOT NULL REFERENCES active (id),
  i INTEGER NOT NULL, j INTEGER NOT NULL, k INTEGER NOT NULL,   -- grid point, in cells
  attempt INTEGER NOT NULL,                                     -- 0 for the first try at the point
  tag TEXT NOT NULL,                                            -- expandable | terminating | failed
  round INTEGER NOT NULL,                                       -- level of the expansion, or round of retries
  parent_i INTEGER, parent_j INTEGER, parent_k INTEGER,         -- NULL for the rest point
  parent_attempt INTEGER,
  failure TEXT,                                                 -- reason, if failed
  energy_j REAL, fx_n REAL, fy_n REAL, fz_n REAL,
  sxx_n_m REAL, sxy_n_m REAL, sxz_n_m REAL, syy_n_m REAL, syz_n_m REAL, szz_n_m REAL,
  third_n_m2 BLOB,                                              -- f64 x 10: 000 001 002 011 012 022 111 112 122 222
  residual_n REAL, min_jacobian REAL, inverted INTEGER, unstable_modes INTEGER, switched INTEGER, volume_m3 REAL,
  iterations INTEGER NOT NULL, factorisations INTEGER NOT NULL, increments INTEGER NOT NULL, seconds REAL NOT NULL,
  checksum INTEGER NOT NULL,                                    -- CRC-32 of the row
  PRIMARY KEY (active, i, j, k, attempt)
) WITHOUT ROWID;
CREATE TABLE state (
  active INTEGER NOT NULL, i INTEGER NOT NULL, j INTEGER NOT NULL, k INTEGER NOT NULL, attempt INTEGER NOT NULL,
  state BLOB NOT NULL,                                          -- f32: displacements, then pressures
  sensitivity BLOB NOT NULL,                                    -- f32: d(state)/dd along x, then y, then z
  checksum INTEGER NOT NULL,                                    -- CRC-32 of the two
  PRIMARY KEY (active, i, j, k, attempt)
);
CREATE TABLE finished (
  active INTEGER PRIMARY KEY REFERENCES active (id),            -- an active node with nothing left to solve
  expandable INTEGER NOT NULL, terminating INTEGER NOT NULL,    -- points by tag, rest not counted
  failed INTEGER NOT NULL, unknown INTEGER NOT NULL,
  attempts INTEGER NOT NULL,                                    -- rows of configuration that it rests on
  fit BLOB,                                                     -- postcard: the fit of adaptive sampling; NULL on a lattice
  checksum INTEGER NOT NULL                                     -- CRC-32 of the row
);
CREATE TABLE intermediate (
  active INTEGER NOT NULL, i INTEGER NOT NULL, j INTEGER NOT NULL, k INTEGER NOT NULL, attempt INTEGER NOT NULL,
  part INTEGER NOT NULL,                                        -- 1 .. increments - 1 of the transition to i, j, k
  numbers BLOB NOT NULL,                                        -- f64 x 23: d, W, h, S (xx xy xz yy yz zz), W_ijk; CRC-32
  PRIMARY KEY (active, i, j, k, attempt, part)
) WITHOUT ROWID;
CREATE TABLE held_out (
  active INTEGER NOT NULL REFERENCES active (id),
  kind TEXT NOT NULL,                                           -- regular | random | uniform
  number INTEGER NOT NULL, step INTEGER NOT NULL,               -- which walk, and which step of it, from 1
  x_m REAL NOT NULL, y_m REAL NOT NULL, z_m REAL NOT NULL,
  tag TEXT NOT NULL,                                            -- expandable | terminating | failed
  failure TEXT,                                                 -- reason, if failed
  energy_j REAL, fx_n REAL, fy_n REAL, fz_n REAL,
  sxx_n_m REAL, sxy_n_m REAL, sxz_n_m REAL, syy_n_m REAL, syz_n_m REAL, szz_n_m REAL,
  residual_n REAL, min_jacobian REAL, inverted INTEGER NOT NULL, unstable_modes INTEGER, switched INTEGER NOT NULL,
  iterations INTEGER NOT NULL, factorisations INTEGER NOT NULL, seconds REAL NOT NULL,
  displacements BLOB NOT NULL,                                  -- f32 x, y, z per node; empty if not kept
  checksum INTEGER NOT NULL,                                    -- CRC-32 of the row
  PRIMARY KEY (active, kind, number, step)
) WITHOUT ROWID;
