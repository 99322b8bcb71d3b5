"""`python -m bayes_inertia` is the command `bayes-inertia`."""

from bayes_inertia.app.cli import main

if __name__ == "__main__":
    main()
