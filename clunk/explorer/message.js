// Change several models at once; the server, which asks for it, need not hear of it again.
for (const [name, [properties]] of Object.entries(cb_obj.data)) models[name].setv(properties, {sync: false});
