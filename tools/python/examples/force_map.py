"""Force map of the bundled phantom, from the scene to a picture. Run it in a clone: it reads assets/."""

import matplotlib.pyplot as plt
import numpy as np
import palpate

palpate.Scene("assets/scenes/palpation.toml").precompute("organ.space", progress=True)
palpate.pack("organ.space", "organ.blob", held_out=20)
organ = palpate.Organ("organ.blob")
x_m, z_m = np.meshgrid(np.linspace(-5e-3, 5e-3, 400), np.linspace(-8e-3, 0, 300))
force_n = np.linalg.norm(organ.force(np.stack([x_m, 0 * x_m, z_m], axis=-1).reshape(-1, 3)), axis=1)
plt.imsave("force_map.png", force_n.reshape(x_m.shape), origin="lower")
print(f"{len(force_n)} forces, at most {force_n.max():.2f} N")
