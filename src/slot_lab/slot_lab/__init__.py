"""Work at the desk with the SLOT robot: bags, reports, validation, identification, films."""
