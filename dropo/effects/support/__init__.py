"""What several effects share: places, changes of model fields, the play operator.

It imports `core` and `mjmodel`. What only one effect needs stays in that effect's file.
"""
