"""Entities as clients receive them: members, names, languages, GeoJSON and earlier versions of NGSI-LD."""
