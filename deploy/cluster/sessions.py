# SPDX-License-Identifier: GPL-2.0-or-later
"""Whether somebody who knows nothing but a configuration file, client.cfg or entitygl2client.cfg, gets a session."""
import pathlib
import re
import ssl

import probe
from configuration import read_property


def tls_of(file):
    """What a connection needs of the certificates that the file names; None where it names none, for plain TCP."""
    text = file.read_text(encoding="utf-8") if file.exists() else ""
    if (folder := read_property(text, "IceSSL.DefaultDir")) is None:
        return None
    ca, certificate, key = (pathlib.Path(folder) / read_property(text, f"IceSSL.{what}") for what in ("CAs", "CertFile", "KeyFile"))
    context = ssl.create_default_context(cafile=ca)
    context.load_cert_chain(certificate, key)
    return context


def log_in(file):
    """Opens and ends a session through each router that the file names; NoAnswer says which one gave none, and why."""
    text = file.read_text(encoding="utf-8")
    tls = tls_of(file)
    router, *endpoints = re.split(r":(?=tcp |ssl )", read_property(text, "Ice.Default.Router"))
    for words in map(str.split, endpoints):
        probe.make_session(words[words.index("-h") + 1], int(words[words.index("-p") + 1]), router,
                           read_property(text, "Axon.User"), read_property(text, "Axon.Password"), tls)
