"""What a study is: its protocol, questionnaires, texts and views."""
