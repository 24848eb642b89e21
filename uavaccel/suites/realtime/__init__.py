"""Agents that need time to think, in environments that go on meanwhile: who is best, and how fast may one simulate?"""
