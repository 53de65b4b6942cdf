"""Boards that BrainFlow knows: ECG, EMG, EEG, EDA, PPG."""
