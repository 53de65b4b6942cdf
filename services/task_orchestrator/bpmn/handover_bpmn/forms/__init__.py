"""Forms of people's Tasks: JSON Schema and form-js, resolved into fields and checked on the server.

`fields` are the fields that the page shows, `json_schema` and `form_js` read the two kinds of forms, and
`form` chooses between them.
"""
