"""Nastran bulk data: GRID, CTETRA, CHEXA, PSOLID, MAT1, and sets as SET in the case control, SPC, SPC1 or PS of GRID.

The cards are read in small, large and free fields. What is neither read nor known not to change a model of solids is
refused by name.
"""

import re
from collections.abc import Iterator
from pathlib import Path

from armflex.errors import Flag
from armflex.fem.mesh import DEEPEST, FLAT, NOT_COMPUTED, Draft, Mesh, words

KINDS = {"CTETRA": {4: "C3D4", 10: "C3D10"}, "CHEXA": {8: "C3D8", 20: "C3D20"}}
"""Card -> number of its nodes -> type of its element."""

HARMLESS = words(
    """
    CORD1R CORD1C CORD1S CORD2R CORD2C CORD2S CORD3R CORD3G SPOINT EPOINT SEQGP POINT
    PLOTEL PLOTEL3 PLOTEL4 PLOTEL6 PLOTEL8 PLOTTET PLOTHEX PLOTPEN PLOTPYR SET1 SET2 SET3 SET4 GROUP
    PBAR PBARL PBEAM PBEAML PBCOMP PBEND PROD PTUBE PELAS PELAST PDAMP PBUSH PBUSH1D PBUSHT PGAP PMASS PSHEAR PVISC
    PWELD PFAST PCOMPG MAT2 MAT3 MAT4 MAT5 MAT8 MAT9 MAT10 MAT11 MATT4 MATT5
    SPCD SPCADD SPCOFF SPCOFF1 SUPORT SUPORT1 BNDFIX BNDFIX1 BNDFREE BNDFREE1 BNDGRID
    ASET ASET1 BSET BSET1 CSET CSET1 QSET QSET1 OMIT OMIT1 USET USET1
    FORCE FORCE1 FORCE2 FORCEAX MOMENT MOMENT1 MOMENT2 PLOAD PLOAD1 PLOAD2 PLOAD4 PLOADB3 PLOADE1 PLOADX1 PLOADFP
    LOAD LOADCLID LSEQ SLOAD GRAV ACCEL ACCEL1 RFORCE RFORCE1 DEFORM DAREA DELAY DPHASE DLOAD RLOAD1 RLOAD2
    TLOAD1 TLOAD2 TIC TICD ACSRCE PRESAX TEMP TEMPD TEMPP1 TEMPP2 TEMPP3 TEMPRB TEMPBC TEMPF TEMPN1 TEMPEX
    CHBDYE CHBDYG CHBDYP PHBDY CONV CONVM PCONV PCONV1 PCONVM QBDY1 QBDY2 QBDY3 QHBDY QVECT QVOL RADBC RADBND RADCAV
    RADLST RADM RADMTX RADSET VIEW VIEW3D VIEWEX
    TABLED1 TABLED2 TABLED3 TABLED4 TABLED5 TABLEM1 TABLEM2 TABLEM3 TABLEM4 TABLES1 TABLEST TABDMP1 TABRND1 TABRNDG
    TABLEHT TABLEH1 TABLE3D TABLEDR
    EIGR EIGRL EIGB EIGC EIGP FREQ FREQ1 FREQ2 FREQ3 FREQ4 FREQ5 MODTRAK MODSEL RANDPS RANDT1 RCROSS TSTEP TSTEP1
    TSTEPNL NLPARM NLPARML NLPCI NLSTEP NLCNTL NLCNTL2 NLOUT NLADAPT ITER NXSTRAT ECHOON ECHOOFF
    DESVAR DLINK DRESP1 DRESP2 DRESP3 DCONSTR DCONADD DOPTPRM DSCREEN DEQATN DTABLE DDVAL
    """
)
"""Cards that neither join, move, weigh nor shape solids: systems that a GRID may name, outputs, properties of elements,
degrees of freedom that are held or reduced, loads, temperatures, tables, and how the model is solved."""

CONTROL = words(
    """
    ID SOL TIME CEND DIAG APP NAST INIT ASSI GEOM ECHO TITL SUBT LABE LINE MAXL PAGE SUBC SUBS REPC SYM SYMC SYMS STAT
    AUTO ANAL SPC LOAD LOAL DLOA LSEQ METH CMET FREQ SDAM RAND TSTE TEMP DEFO NLPA NLST NLIC NLRE STEP IC SUPO BC OUTP
    OUTR SURF VOLU SKIP OFRE OTIM OMOD OLOA DISP VECT VELO ACCE PRES SDIS SVEL SACC SVEC SPCF MPCF BOUT BCRE BGRE GPFO
    GPST GPKE GPRS STRE ELST STRA STRF FORC ELFO ESE EKE EDE EDES STRN PFMO MODA MEFF MODE RESV RIGI CRSP SETP SHEL
    GROU GRDC WEIG ELSU ENTH FLUX HDOT THER HTFL HOUT DATA DRSP DESO DESG DESS DESV DSYM XYPL XYPR XYPU XYPE XYPA CSCA
    XTIT YTIT XAXI YAXI XGRI YGRI XMIN XMAX YMIN YMAX TCUR FORM RESU SCRE MSGL HISO PLOT PARA VUGR UNIT SENS MASS FLSF
    ADAM MONI AERO TRIM DIVE FMET CSSC HTOC POST OFFS HDF5 MDLP
    """
)
"""The first four letters, which Nastran compares, of what an executive or case control may say without a change of the
model. MPC, NSM, B2GG, K2GG, M2GG, BCSET, BGSET, BOLTLD and SUPER change it."""

ELEMENTAL = words("STRE ELST STRA FORC ELFO ESE EKE EDE EDES STRN GPRS")
"""Requests of results that elements have."""

PARAMETERS = words(
    """
    ACOUT ADMPOST ALPHA1 ALPHA2 AMLS ARBMASP AUNITS AUTOGOUT AUTOMSET AUTOQSET AUTOSPC AUTOSPCR BAILOUT BIGER BUSHNM
    CDIF CDITER CDPCH CDPRT CHECKEL CHECKOUT CONFAC COUPMASS CURV CURVPLOT CWDIAGP DBALL DBCCONV DBDICT DBDN DBEXT
    DBRCV DBUP DDRMM DESPCH DESPCH1 DFREQ DPEPS DSNOKD DYNSPCF ENFMETH ENFMOTN EPPRT EPZERO ERROR EST EXTOUT EXTUNIT
    FACTOR FIXEDB FOLLOWK FRQDEPO G GEOMU GFL GPECT GRDEQ GRDPNT HDF5 HFREQ HFREQFL IFP IFTM INREL INRLM IRES ITAPE
    K6ROT LANGLE LFREQ LFREQFL LGDISP LMODES LMODESFL LOADU MARC MAXLINES MAXRATIO MESH METHCMRS MODACC NASPRT NDAMP
    NEWSEQ NLAYERS NLTOL NMLOOP NOCOMPS NOELOF NOELOP NOFISR NOGPF NOINT NOMSGSTR NONCUP NUMOUT NUMOUT1 OCMP ODS
    OELMSET OG OGEOM OGPS OIBULK OLDSEQ OMACHPR OMAXR OMID OMPT OMSGLVL OP2 OP2FMT OPGEOM OPTEXIT OPTION OSWELM OSWPPT
    OUGCORD OUNIT1 OUNIT2 OUTOPT PATPLUS PATVER PCHCOMP PDRMSG PEDGEP PLTMSG POST POSTEXT POSTOPT POSTU PRGPST PRINT
    PRPA PRPJ PRTCSTM PRTMAXIM PRTPCOMP PRTRESLT PVALINIT RESLTOPT RESVEC RESVINER RMSINT RSPECTRA SCRSPEC SEMAP SERST
    SHLDAMP SIGMA SKINOUT SNORM SNORMPRT SOFTEXIT SOLADJC SPARSEDM SPARSEDR SRTELTYP SRTOPT START STIME STRFLUR SUBID
    TABS TESTNEG TINY TSTATIC UNITSYS UNSYMF UPDTBSH USETPRT USETSEL USETSTR VREF VUBEAM VUGJUMP VUHEXA VUTETRA W3 W4
    WRBEAMB XFLAG XYUNIT
    """
)
"""PARAM and MDLPRM that concern neither stiffness nor mass of solids; WTMASS is read."""

SHIFTS = "123"
"""Components of a node's shift."""

UPWARD = [*range(12), 16, 17, 18, 19, 12, 13, 14, 15]
"""Nodes of a CHEXA of twenty -> those of a C3D20: the edges upward come before those of the top."""

_SET = re.compile(r"SET\s+(\w+)\s*=\s*(.*)", re.I | re.S)
_ITEM = re.compile(r"(EXCEPT )?(ALL|\d+)(?: (?:THRU|TO) (\d+)(?: BY (\d*[1-9]\d*))?)?(?: |$)")
_INCLUDE = re.compile(r"INCLUDE\s+(.*)", re.I)

Line = tuple[int, str]
"""A line that is neither empty nor a comment, and its number."""


def read_bdf(path: Path, unit: str = "m") -> Mesh:
    """Read a Nastran file; see `inp.read_inp`, also for what is refused."""
    draft = Draft(path, unit)
    lines = [*_lines(draft, path)]
    begins = (place for place, (_, text) in enumerate(lines) if re.match(r"\s*BEGIN\b", text, re.I))
    begin = next(begins, -1)
    sets: dict[str, tuple[list[str], int]] = {}
    controlled, scale = _control(draft, lines[: max(begin, 0)], sets), None
    if begin >= 0 and not re.fullmatch(r"BEGIN(\s+BULK)?", lines[begin][1].strip(), re.I):
        draft.fail(f"{lines[begin][1].strip()[:40]!r} begins what is not read, expected BEGIN BULK", lines[begin][0])
    flags, properties, foreign = [Flag("no_end", f"{path} has no ENDDATA: is it whole?")], [], {}
    held: dict[str, list[tuple[list[str], int, str]]] = {}
    single, usual = dict[int, tuple[str, int]](), ("", 0)
    for line, (word, *cells) in _cards(draft, lines[begin + 1 :]):
        cells = [*(cell.strip() for cell in cells), *[""] * 8]
        if match := _SET.fullmatch(word):
            _add_set(draft, sets, match, line)
        elif word == "GRID":
            if cells[1] not in ("", "0") or cells[7] not in ("", "0"):
                draft.fail("GRID in a coordinate system of its own or in a superelement is not read", line)
            (number,) = draft.whole(line, cells[:1], 1)
            draft.node(number, number, draft.numbers(line, cells[2:5]), line)
            single[number] = cells[6], line
        elif word == "GRDSET":
            if cells[1] not in ("", "0") or cells[7] not in ("", "0"):
                draft.fail("GRDSET with a coordinate system or a superelement of every GRID is not read", line)
            usual = cells[6], line
        elif word in KINDS or word in FLAT:
            number, part = draft.whole(line, [cells[0], cells[1] or cells[0]], 2)
            corners = draft.whole(line, cells[2 : 2 + FLAT.get(word, 20)])  # of faces thickness and angle come after
            whole = all(cells[2 : 2 + len(corners)])
            if (kind := KINDS[word].get(len(corners) * whole) if word in KINDS else word) is None:
                expected = " or ".join(map(str, KINDS[word]))
                gaps = "" if whole else " and gaps between them"
                draft.fail(f"{word} {number} has {len(corners)} nodes{gaps}, expected {expected}", line)
            draft.element(number, number, kind, [corners[i] for i in UPWARD] if kind == "C3D20" else corners, line)
            draft.groups.setdefault(f"{'PID' if word in FLAT else 'PSOLID'}{part}", []).append(number)
        elif word in ("PSOLID", "PSHELL", "PCOMP"):
            if word == "PSOLID" and cells[6].upper() not in ("", "SMECH"):
                draft.fail(f"PSOLID of {cells[6]} is not computed: solids of a structure (SMECH) are", line)
            properties.append((f"{'PSOLID' if word == 'PSOLID' else 'PID'}{cells[0]}", word, cells[1], line))
        elif word == "MAT1":
            young, shear, poisson, mass = draft.numbers(line, cells[1:5])
            if bool(young) + bool(shear) + bool(cells[3]) < 2:
                draft.fail("MAT1 needs two of E, G and NU", line)
            poisson = poisson if cells[3] else 0.5 * young / shear - 1.0
            young = young or 2.0 * shear * (1.0 + poisson)
            draft.material(cells[0], line, young=young, poisson=poisson, density=mass)
        elif word in ("SPC", "SPC1"):
            for axes, *nodes in [cells[2:0:-1], cells[5:3:-1]] if word == "SPC" else [cells[1:]]:
                named = [cell.upper() for cell in nodes if cell]
                held.setdefault(f"SPC{cells[0]}", []).extend([(named, line, axes)] if named else [])
        elif word == "SPCADD":
            for other in filter(None, cells[1:]):
                held.setdefault(f"SPC{cells[0]}", []).append(([f"SPC{other}"], line, ""))
        elif word in ("PARAM", "MDLPRM"):
            for name, value in zip(cells[::2], cells[1::2], strict=False):
                factor = _parameter(draft, name, value, line) if name else None
                if scale not in (None, factor or scale):
                    draft.fail(f"PARAM {name} stands twice, with {scale:g} and {factor:g}", line)
                scale = factor or scale
        elif word == "ENDDATA":
            flags = []
            break
        elif word not in HARMLESS:
            draft.fail(f"{word[:40]} is not computed, and is not known to be harmless: {NOT_COMPUTED}", line)
        elif word.startswith("MAT"):
            foreign[cells[0]] = word
    for name, word, material, line in properties:
        if word == "PSOLID":
            if material in foreign and material not in draft.materials and name in draft.groups:
                draft.fail(f"PSOLID of a {foreign[material]} is not computed: solids of a MAT1 are", line)
            draft.sections.append((draft.groups.get(name, ()), material, line))
        elif name in draft.groups:
            draft.fail(f"{word} makes shells of {name}, which are not computed: {NOT_COMPUTED}", line)
    for material in draft.materials.values():
        mass = material.pop("density")
        material |= {"density": (controlled or scale or 1.0) * mass} if mass else {}
    for number, (axes, line) in single.items():
        if not (axes := (axes or usual[0]).strip("0")) or {*axes} <= {*"456"}:  # nodes of solids do not turn
            continue
        if not {*SHIFTS} <= {*axes} <= {*"123456"}:
            draft.fail(f"GRID {number} is held in {axes} alone by its PS, expected all of {SHIFTS}, or an SPC1", line)
        draft.sets.setdefault("PS", []).append(number)
        draft.held = ("PS",)
    requested = [(name, *members, SHIFTS) for name, members in sets.items()]
    draft.supports = {name: several[0][1] for name, several in held.items() if several}
    for name, several in held.items():
        for card in several:
            others = held.get(card[0][0], ()) if card[0][0].startswith("SPC") else [card]
            requested += [(name, *other) for other in others]
    last, axes_of = max(draft.nodes, default=0), dict[tuple[str, int], tuple[int, set[str]]]()
    for name, given, line, axes in requested:
        if name not in draft.unread:
            members = _members(draft, name, given, line, last)
            draft.sets.setdefault(name, []).extend(members)
            for node in members:
                axes_of.setdefault((name, node), (line, set()))[1].update(axes)
    for (name, node), (line, axes) in axes_of.items():
        if not axes >= {*SHIFTS}:  # as a plane of symmetry does
            text = f"holds node {node} in {''.join(sorted(axes))} alone, and a set is held in all of {SHIFTS}"
            draft.unread.setdefault(name, (text, line))
    draft.sets = {name: nodes for name, nodes in draft.sets.items() if name not in draft.unread}
    return draft.mesh(flags)


def _lines(draft: Draft, path: Path, depth: int = 0) -> Iterator[Line]:
    """Yield the lines of a file and of those that it includes, without what is a comment."""
    waiting: Line | None = None
    for number, line in draft.text_lines(path):
        text = line.split("$")[0].rstrip()
        if not text.strip():
            continue
        if waiting is not None:  # the name of a file goes on until its quote ends
            number, text = waiting[0], waiting[1] + text.strip()
        if (match := _INCLUDE.match(text.strip())) is None:
            yield number, text
            continue
        name = match[1].strip()
        if waiting := (number, text) if name[0] in "'\"" and name.count(name[0]) < 2 else None:
            continue
        if depth >= DEEPEST:
            draft.fail(f"INCLUDE: at most {DEEPEST} files include one another", number)
        yield from _lines(draft, draft.beside(path, name, number), depth + 1)
    if waiting is not None:
        draft.fail("INCLUDE: the quote of its file's name does not end", waiting[0])


def _control(draft: Draft, lines: list[Line], sets: dict[str, tuple[list[str], int]]) -> float | None:
    """Take in the sets of an executive and case control; return what it multiplies all masses by."""
    factor, plotted, text, begun = None, False, "", 0
    asked: dict[str, set[str]] = {}
    for line, more in lines:
        begun, text = begun if text else line, f"{text} {more.strip()}".strip()
        word = re.split(r"\W", text)[0].upper()
        if text.endswith(",") and word[:4] not in ("TITL", "SUBT", "LABE"):
            continue
        if match := _SET.fullmatch(text):
            _add_set(draft, sets, match, begun)
        elif word == "PARAM":
            name, value, *_ = [*re.split(r"[\s,=]+", text)[1:], "", ""]
            factor = _parameter(draft, name, value, begun) or factor
        elif word[:4] in CONTROL or plotted:
            plotted |= bool(re.match(r"OUTPUT\s*\(", text, re.I))  # what follows is of plots
            if match := re.fullmatch(r"\w+\s*(?:\(.*\))?\s*=\s*(\w+)", text):
                asked.setdefault(match[1].upper(), set()).add(word[:4])
        else:
            draft.fail(f"{text[:40]!r} of the control changes the model, or is not known", begun)
        text = ""
    for name in sets.keys() & asked.keys():
        if asked[name] <= ELEMENTAL:
            draft.unread[name] = "is one of elements, of which results are asked for", sets[name][1]
    return factor


def _parameter(draft: Draft, name: str, value: str, line: int) -> float | None:
    """Return what a PARAM multiplies all masses by."""
    if name.upper() in PARAMETERS:
        return None
    (number,) = draft.numbers(line, [value]) if re.match(r"[-+.\d]", value) else [0.0]
    if name.upper() == "WTMASS" and number > 0.0:
        return number
    if number == 1.0 and name.upper() in ("CK1", "CM1"):
        return None
    draft.fail(f"PARAM {name},{value} changes the model, or is not known", line)


def _add_set(draft: Draft, sets: dict[str, tuple[list[str], int]], match: re.Match[str], line: int) -> None:
    """Take in a SET; what it is of shows when all nodes are there."""
    name, given = match[1].upper(), re.split(r"[\s,]+", match[2].upper().strip(" ,"))
    if name in sets and sets[name][0] != given:
        draft.unread[name] = f"stands twice, in line {sets[name][1]} too", line
    sets.setdefault(name, (given, line))


def _members(draft: Draft, name: str, given: list[str], line: int, last: int) -> list[int]:
    """Return the nodes, none beyond the last, of numbers, THRU with BY, EXCEPT for those within it, and ALL.

    A set that names anything else is left unread.
    """
    chosen: dict[int, None] = {}
    nodes, text, at, stop, excepting = draft.nodes, " ".join(given), 0, 0, False
    while at < len(text):
        if (match := _ITEM.match(text, at)) is None:
            word = text[at:].split()[0][:40]
            draft.unread[name] = f"has {word!r}, expected nodes, THRU, EXCEPT or ALL", line
            return []
        at = match.end()
        first = 1 if match[2] == "ALL" else int(match[2])
        excepting = bool(match[1]) or (excepting and first <= stop)
        until = last if match[2] == "ALL" else int(match[3] or first)
        several = range(first, min(until, last) + 1, int(match[4] or 1))
        several = several if len(several) < len(nodes) else [node for node in nodes if node in several]
        if excepting:
            chosen = {node: None for node in chosen if node not in several}
            continue
        if match[2] != "ALL" and not match[3] and first not in nodes:
            draft.unread[name] = f"names node {first}, which is not there", line
            return []
        chosen |= dict.fromkeys(node for node in several if node in nodes)
        stop = until
    return [*chosen]


def _cards(draft: Draft, lines: list[Line]) -> list[tuple[int, list[str]]]:
    """Return the line and the fields of every card, continued ones whole, wherever that stands; a SET is one field."""
    cards, waiting, mark = list[tuple[int, list[str]]](), dict[str, tuple[int, list[str]]](), ""
    for number, text in lines:
        last = cards[-1][1] if cards else []
        if last and _SET.match(last[0]) and last[0].endswith(","):
            last[0] += text
            continue
        cells, after = ([text.strip()], "") if _SET.match(text.strip()) else _fields(draft, number, text)
        if cells[0][:1] in ("", "+", "*") and len(cells) > 1:
            if not cards:
                draft.fail(f"{text.strip()[:40]!r} continues no card", number)
            if cells[0][1:] in waiting:
                last = waiting.pop(cells[0][1:])[1]
            elif mark and cells[0] and mark[1:] != cells[0][1:]:
                draft.fail(f"{cells[0]!r} does not continue the line before, which goes on at {mark!r}", number)
            elif not cells[0]:
                waiting.pop(mark[1:], None)
            last += cells[1:]
        else:
            if mark in ("+", "*"):
                draft.fail(f"expected what continues the line before, which goes on at {mark!r}", number)
            cards.append((number, last := [cells[0].rstrip("*").upper(), *cells[1:]]))
        mark = after
        if mark[1:] in waiting:
            draft.fail(f"{mark!r} is where the card of line {waiting[mark[1:]][0]} goes on, too", number)
        if mark[1:]:
            waiting[mark[1:]] = number, last
    for name, (number, _) in waiting.items():
        draft.fail(f"goes on in a line that begins with {name!r} behind + or *, which is not there", number)
    return cards


def _fields(draft: Draft, line: int, text: str) -> tuple[list[str], str]:
    """Return the name and the eight small or four large fields of a line, and by what the next one continues it."""
    if "," in text or ("\t" in text and not any(" " in cell.strip() for cell in text.split("\t"))):
        name, *cells = (cell.strip() for cell in text.split("," if "," in text else "\t"))
        count = 4 if "*" in name else 8
        after = cells[count] if len(cells) > count else ""
        if (after and after[0] not in "+*") or any(cells[count + 1 :]):
            draft.fail(f"more than {count} fields in a line: a card goes on in the next", line)
    else:
        text = text.expandtabs(8)
        name = text[:8].strip()
        count, wide = (4, 16) if "*" in name else (8, 8)
        cells, after = [text[i : i + wide].strip() for i in range(8, 72, wide)], text[72:80].strip()
        after = after if after[:1] in ("+", "*") else ""
    return [name, *[*cells, *[""] * count][:count]], after
