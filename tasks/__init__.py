"""The stages of the method as cached Prefect tasks, and the artifact store under them."""
