"""Result records, and what is made from them: MLflow runs, tables, pictures."""
