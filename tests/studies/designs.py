"""Ten thousand designs for `table`, drawn at random: `python tests/studies/designs.py > designs.csv`."""

import numpy as np

COUNT, SEED = 10_000, 0


def main():
    """Print a table of designs of other gaps, coefficients of friction and forces."""
    draws = np.random.default_rng(SEED)
    columns = [draws.uniform(*ends, COUNT) for ends in ((0.005, 0.2), (0.1, 0.6), (20, 80))]
    print("name,shroud.gap [mm],friction.mu,drive.F_0 [N]")
    for i, (gap, mu, force) in enumerate(zip(*columns, strict=True)):
        print(f"d{i},{gap:.5f},{mu:.4f},{force:.3f}")


if __name__ == "__main__":
    main()
