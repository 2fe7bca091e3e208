"""Why points got their labels: one document that commands, recordings, the explorer and reports
read.

``ledger`` keeps what each scan contributed while ``repeat`` runs a method again; ``words`` says it.

Private: other packages do not import it.
"""
