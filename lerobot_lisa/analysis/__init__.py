"""What a trained policy does, question by question.

A command (`commands`) says what to evaluate; `recording` lets LeRobot's own code run it and keeps a trace of every
step. Each question reads the trace, and has its numbers, figures and words in one place: does it succeed (`success`),
what do its skills mean (`skills`), can it be steered (`control`), does it listen (`listening`). Whether skills match
annotated subtasks (`annotations`) is asked of demonstrations, how training went (`training`) of its log. `report`
strings the answers together into one page.
"""
